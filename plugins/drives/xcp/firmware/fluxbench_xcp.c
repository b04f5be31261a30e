#include "fluxbench_xcp.h"

#include <math.h>

#include "fluxbench_config.h"

#define TURN_RAD 1.4629180792671596e-9f /* 2 pi / 2^32 */
#define SLACK 1.0001f                   /* numbers came as singles */
#define TRIP 1.2f                       /* of the current limit: the ripple may pass it */
#define MODULATED 0.57735f              /* of the bus, in every direction */

volatile struct fluxbench fluxbench = {
    .magic = FLUXBENCH_MAGIC,
    .version = FLUXBENCH_VERSION,
    .sampling_hz = FLUXBENCH_SAMPLING_HZ,
    .pwm_hz = FLUXBENCH_PWM_HZ,
    .max_current_a = FLUXBENCH_MAX_CURRENT_A,
    .max_voltage_v = FLUXBENCH_MAX_VOLTAGE_V,
    .dc_bus_v = FLUXBENCH_DC_BUS_V,
    .delay_samples = FLUXBENCH_DELAY_SAMPLES,
    .watchdog_ticks = FLUXBENCH_WATCHDOG_TICKS,
};

/* What the host cannot write. */
static struct {
    uint32_t state, fault, order, refused;
    uint32_t k; /* ticks since the program began */
    uint32_t beat, silent;
    uint32_t wave, turn;
    float limit_current_a, limit_voltage_v;
    struct fluxbench_vector set_point, slope, integral; /* in dq */
    struct fluxbench_vector first, base;                /* of the frozen voltage: its first value, then its mean */
    struct fluxbench_program program;
} own;

static float square(struct fluxbench_vector v)
{
    return v.x * v.x + v.y * v.y;
}

static struct fluxbench_vector turned(struct fluxbench_vector v, struct fluxbench_vector by)
{
    const struct fluxbench_vector out = {v.x * by.x - v.y * by.y, v.x * by.y + v.y * by.x};

    return out;
}

static struct fluxbench_vector back(struct fluxbench_vector direction)
{
    const struct fluxbench_vector out = {direction.x, -direction.y};

    return out;
}

/* Orders */

/* A number that is none fails every comparison. */
static bool is_allowed(const struct fluxbench_program *p, float current_a, float voltage_v)
{
    const struct fluxbench_vector corner = {fabsf(p->start.x) + fabsf(p->swept.x), fabsf(p->start.y) + fabsf(p->swept.y)};
    const float gains = p->feed_forward + p->proportional.x + p->proportional.y + p->integral.x + p->integral.y;

    return square(corner) <= SLACK * current_a * current_a && fabsf(p->amplitude_v) <= SLACK * voltage_v &&
           fabsf(square(p->direction) - 1.0f) < 1e-3f && gains >= 0.0f && gains < 1e9f && p->freeze_ticks > 1u &&
           p->ramp_ticks <= p->settle_ticks && p->mode <= (uint32_t)FLUXBENCH_INJECTION;
}

static bool begins(struct fluxbench_program p)
{
    const struct fluxbench_vector turn = turned(own.program.direction, back(p.direction));
    const float ramp = p.ramp_ticks > 0u ? 1.0f / (float)p.ramp_ticks : 1.0f;

    if (!is_allowed(&p, own.limit_current_a, own.limit_voltage_v)) {
        return false;
    }
    own.set_point = turned(own.set_point, turn); /* the current stays where it is in the stator */
    own.integral = turned(own.integral, turn);
    own.slope.x = (p.start.x - own.set_point.x) * ramp;
    own.slope.y = (p.start.y - own.set_point.y) * ramp;
    own.k = own.wave = own.turn = 0u;
    own.program = p;
    return true;
}

static bool switches_on(struct fluxbench_program p)
{
    const bool fits = p.limit_current_a > 0.0f && p.limit_current_a <= SLACK * FLUXBENCH_MAX_CURRENT_A &&
                      p.limit_voltage_v > 0.0f && p.limit_voltage_v <= SLACK * FLUXBENCH_MAX_VOLTAGE_V;
    const struct fluxbench_vector none = {0.0f, 0.0f};

    if (own.state != (uint32_t)FLUXBENCH_OFF || !fits) {
        return false;
    }
    own.limit_current_a = p.limit_current_a;
    own.limit_voltage_v = p.limit_voltage_v;
    own.set_point = own.integral = none;
    own.silent = 0u;
    own.beat = fluxbench.beat;
    if (!begins(p)) {
        return false;
    }
    own.state = (uint32_t)FLUXBENCH_ON;
    return true;
}

static void switch_off(void)
{
    if (own.state == (uint32_t)FLUXBENCH_ON) {
        own.state = (uint32_t)FLUXBENCH_OFF;
    }
}

static bool is_obeyed(uint32_t what)
{
    switch (what) {
    case FLUXBENCH_SWITCH_ON:
        return switches_on(fluxbench.program);
    case FLUXBENCH_RUN:
        return own.state == (uint32_t)FLUXBENCH_ON && begins(fluxbench.program);
    case FLUXBENCH_CLEAR:
        own.state = (uint32_t)FLUXBENCH_OFF;
        own.fault = 0u;
        return true;
    default:
        switch_off();
        return what == (uint32_t)FLUXBENCH_SWITCH_OFF;
    }
}

static void obey(void)
{
    const uint32_t order = fluxbench.order;

    if (order != own.order) {
        own.order = order;
        own.refused = is_obeyed(order & 0xFFFFu) ? 0u : 1u;
    }
}

/* Protection */

static void fault(uint32_t which)
{
    own.state = (uint32_t)FLUXBENCH_FAULTED;
    own.fault = which;
}

void fluxbench_trip(void)
{
    fault((uint32_t)FLUXBENCH_TRIPPED);
}

static void guard(struct fluxbench_vector i, float v_dc)
{
    const float most_a = TRIP * own.limit_current_a;

    own.silent = fluxbench.beat == own.beat ? own.silent + 1u : 0u;
    own.beat = fluxbench.beat;
    if (!(square(i) <= most_a * most_a)) {
        fault((uint32_t)FLUXBENCH_OVERCURRENT);
    } else if (!(v_dc > 0.0f)) {
        fault((uint32_t)FLUXBENCH_BUS);
    } else if (FLUXBENCH_WATCHDOG_TICKS > 0u && own.silent > FLUXBENCH_WATCHDOG_TICKS) {
        fault((uint32_t)FLUXBENCH_HEARTBEAT);
    }
}

/* Voltage */

static uint32_t phase(void)
{
    if (own.k < own.program.settle_ticks) {
        return (uint32_t)FLUXBENCH_SETTLING;
    }
    return own.k - own.program.settle_ticks < own.program.capture_ticks ? (uint32_t)FLUXBENCH_CAPTURING
                                                                        : (uint32_t)FLUXBENCH_HOLDING;
}

static struct fluxbench_vector limited(struct fluxbench_vector v, float most)
{
    const float length = square(v);
    const float scale = length > most * most ? most / sqrtf(length) : 1.0f;
    const struct fluxbench_vector out = {scale * v.x, scale * v.y};

    return out;
}

/* 0, +1 from 1/8 to 3/8 of a period, -1 from 5/8 to 7/8, straight in between. */
static float trapezoid(uint32_t wave)
{
    const float eighths = (float)wave * (8.0f / 4294967296.0f);
    const float triangle = eighths < 2.0f ? eighths : (eighths < 6.0f ? 4.0f - eighths : eighths - 8.0f);

    return fminf(1.0f, fmaxf(-1.0f, triangle));
}

static void move_set_point(void)
{
    const struct fluxbench_program *p = &own.program;
    const float along = p->mode == (uint32_t)FLUXBENCH_CONTROL ? trapezoid(own.wave) : 0.0f;

    if (own.k < p->ramp_ticks) {
        own.set_point.x += own.slope.x;
        own.set_point.y += own.slope.y;
    } else {
        own.set_point.x = p->start.x + along * p->swept.x;
        own.set_point.y = p->start.y + along * p->swept.y;
    }
}

static struct fluxbench_vector controlled(struct fluxbench_vector i, float most_v)
{
    const struct fluxbench_program *p = &own.program;
    const struct fluxbench_vector error = {own.set_point.x - i.x, own.set_point.y - i.y};
    const struct fluxbench_vector asked = {
        p->feed_forward * own.set_point.x + p->proportional.x * error.x + own.integral.x,
        p->feed_forward * own.set_point.y + p->proportional.y * error.y + own.integral.y,
    };

    if (square(asked) <= most_v * most_v) {
        own.integral.x += p->integral.x * error.x;
        own.integral.y += p->integral.y * error.y;
    }
    return limited(asked, most_v);
}

/* The mean over the second half of settling, about its first value: few digits are lost. */
static void freeze(struct fluxbench_vector v)
{
    const uint32_t half = own.program.freeze_ticks / 2u;
    const float part = 1.0f / (float)(own.program.freeze_ticks - half);

    if (own.k == half) {
        own.first = own.base = v;
    }
    own.base.x += (v.x - own.first.x) * part;
    own.base.y += (v.y - own.first.y) * part;
}

static struct fluxbench_vector injected(void)
{
    const struct fluxbench_program *p = &own.program;
    const float square_wave = own.wave < 0x80000000u ? 1.0f : -1.0f;
    const float volts = p->amplitude_v * (p->sine != 0u ? sinf((float)own.wave * TURN_RAD) : square_wave);
    const float turn = (float)own.turn * TURN_RAD;
    const struct fluxbench_vector out = {own.base.x + volts * cosf(turn), own.base.y + volts * sinf(turn)};

    return out;
}

/* In dq. */
static struct fluxbench_vector voltage(struct fluxbench_vector i, float most_v)
{
    const struct fluxbench_program *p = &own.program;
    const bool injects = p->mode == (uint32_t)FLUXBENCH_INJECTION;
    struct fluxbench_vector v;

    move_set_point();
    if (injects && own.k >= p->freeze_ticks && phase() != (uint32_t)FLUXBENCH_HOLDING) {
        v = limited(injected(), most_v);
    } else {
        v = controlled(i, most_v);
        if (injects && own.k >= p->freeze_ticks / 2u && own.k < p->freeze_ticks) {
            freeze(v);
        }
    }
    return v;
}

static void advance(void)
{
    const struct fluxbench_program *p = &own.program;
    const bool injects = p->mode == (uint32_t)FLUXBENCH_INJECTION;

    if (injects ? own.k >= p->freeze_ticks : phase() == (uint32_t)FLUXBENCH_CAPTURING) {
        own.wave += p->wave_step;
        own.turn += p->turn_step;
    }
    if (phase() != (uint32_t)FLUXBENCH_HOLDING) {
        own.k++;
        if (phase() == (uint32_t)FLUXBENCH_HOLDING) {
            own.wave = 0u;
        }
    }
}

bool fluxbench_step(float i_alpha, float i_beta, float v_dc, struct fluxbench_vector *v)
{
    const struct fluxbench_vector i = {i_alpha, i_beta}, none = {0.0f, 0.0f};
    bool gates;

    obey();
    if (own.state == (uint32_t)FLUXBENCH_ON) {
        guard(i, v_dc);
    }
    gates = own.state == (uint32_t)FLUXBENCH_ON && own.program.mode != (uint32_t)FLUXBENCH_GATES_OFF;
    *v = none;
    if (gates) {
        const float most_v = fminf(own.limit_voltage_v, MODULATED * v_dc);

        *v = turned(voltage(turned(i, back(own.program.direction)), most_v), own.program.direction);
    } else {
        own.set_point = own.integral = none;
    }
    fluxbench.row.tick++;
    fluxbench.row.status = own.state | phase() << 2 | own.refused << 4 | own.fault << 8 | (own.order & 0xFFFF0000u);
    fluxbench.row.i.x = i.x;
    fluxbench.row.i.y = i.y;
    fluxbench.row.v.x = v->x;
    fluxbench.row.v.y = v->y;
    fluxbench.row.v_dc = v_dc;
    if (own.state == (uint32_t)FLUXBENCH_ON) {
        advance();
    }
    return gates;
}
