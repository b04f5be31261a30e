#include "fb_power.h"

#include <string.h>

#include "fb_board.h"
#include "fb_capture.h"
#include "fb_control.h"
#include "fb_registers.h"
#include "fb_ripple.h"
#include "fluxbench_registers.h"

#define BUS_LOW 0.5f
#define BUS_HIGH 1.3f
#define BUS_SPAN 10.0f /* no converter reads further */
#define MORE 1.001f /* than the longest voltage, squared: rounding */
#define PER_SQRT3 0.57735027f
#define SHOWN_S 2e-3f       /* time constant behind telemetry */
#define SAFE_HZ 250.0f      /* bandwidth with which a current is brought to safety */
#define SAFE_RAMP_S 6e-3f   /* fast, but without a jerk */
#define SAFE_LONGEST_S 1e-2f
#define SAFE_PART 0.5f      /* of the voltage limit that this ramp may take */

/* What a fault holds against what; reckoned when arming, so that nothing is divided later. */
struct bounds {
    float trip_a, trip_square;
    float most_v;
    float per_rated_square;
    float energy_j; /* 0: no bound */
    uint32_t duration;
    float watts_per_square; /* copper loss for the vector's square */
    struct fb_tuning safe;
    float safe_samples, safe_samples_per_a, safe_samples_most;
};

static struct {
    uint8_t state, phase, cause;
    uint16_t faults;
    float fault_value, fault_limit;
    bool gates;
    bool is_recording;
    bool off_after;
    struct fb_plan plan;
    struct fb_piece piece;
    uint32_t at; /* of the plan's pieces, edges of its trapezoid included */
    uint32_t k;  /* of the piece's samples */
    struct fb_loop loop;
    struct fb_tuning tuning;
    struct fb_vector frame; /* direction of the believed d axis */
    struct bounds bounds;
    float spent_s; /* of the overload's integral */
    struct fb_sum energy_j;
    struct fb_vector shown;
    float v_dc;
    uint32_t tick, armed_at, begun_at, due;
    uint32_t fed_us, watchdog_us;
    uint32_t rows_left;
    uint8_t open_interlocks;
} power;

static struct fb_plan next_plan; /* made in the main loop, copied in one go */
static uint32_t recorded_rows;   /* that capture_arm made ready; 0: none */
static float sample_s, shown_step;

void fb_power_init(void)
{
    memset(&power, 0, sizeof(power));
    power.state = FLUXBENCH_STATE_DISARMED;
    power.phase = FLUXBENCH_PHASE_IDLE;
    power.piece.mode = FB_OFF;
    power.piece.samples = FB_ENDLESS;
    power.frame.x = 1.0f;
    power.watchdog_us = (uint32_t)(1e6f * fb_facts.watchdog_s);
    recorded_rows = 0;
    sample_s = 1.0f / fb_facts.sampling_hz;
    shown_step = sample_s < SHOWN_S ? sample_s / SHOWN_S : 1.0f;
    fb_board_gates(false);
}

bool fb_power_is_energised(uint8_t state)
{
    return state == FLUXBENCH_STATE_HOLDING || state == FLUXBENCH_STATE_RUNNING || state == FLUXBENCH_STATE_STOPPING;
}

struct fb_news fb_power_news(void)
{
    struct fb_news news;

    fb_board_lock();
    news.state = power.state;
    news.phase = power.phase;
    news.cause = power.cause;
    news.faults = power.faults;
    news.open_interlocks = power.open_interlocks;
    news.fault_value = power.fault_value;
    news.fault_limit = power.fault_limit;
    news.shown = power.shown;
    news.base = power.loop.base;
    news.v_dc = power.v_dc;
    news.energy_j = power.energy_j.total;
    news.tick = power.tick;
    fb_board_unlock();
    return news;
}

/* What the interrupt and the main loop share; the main loop holds the interrupt off meanwhile. */

static void gates(bool on)
{
    if (power.gates != on) {
        power.gates = on;
        fb_board_gates(on);
    }
}

static void hold_for_good(enum fb_mode mode)
{
    const struct fb_vector none = {0.0f, 0.0f};

    power.piece.mode = mode;
    power.piece.samples = FB_ENDLESS;
    power.piece.start = power.loop.set_point;
    power.piece.slope = none;
    power.piece.captured = false;
    power.piece.averaged = false;
    power.piece.injecting = false;
    power.plan.count = 0;
    power.plan.trapezoid.corners = 0;
    power.at = 0;
    power.k = 0;
}

static void give_up(void)
{
    if (power.state == FLUXBENCH_STATE_RUNNING || power.is_recording) {
        power.phase = FLUXBENCH_PHASE_GIVEN_UP;
        power.is_recording = false;
    }
}

static void off(void)
{
    const struct fb_vector none = {0.0f, 0.0f};

    gates(false);
    power.loop.set_point = none;
    power.loop.integral = none;
    hold_for_good(FB_OFF);
}

static uint8_t phase_of(const struct fb_piece *piece)
{
    if (piece->captured) {
        return FLUXBENCH_PHASE_CAPTURING;
    }
    return piece->mode == FB_CONTROL && fb_square(piece->slope) > 0.0f ? FLUXBENCH_PHASE_RAMPING
                                                                       : FLUXBENCH_PHASE_SETTLING;
}

static void finish(void)
{
    if (power.state == FLUXBENCH_STATE_FAULTED) {
        off();
        return;
    }
    if (power.state == FLUXBENCH_STATE_RUNNING || power.is_recording) {
        power.phase = FLUXBENCH_PHASE_COMPLETE;
        power.is_recording = false;
    }
    power.state = FLUXBENCH_STATE_HOLDING;
    hold_for_good(power.off_after ? FB_OFF : FB_CONTROL);
}

/* The next piece of the plan; its end is followed by holding. */
static void next_piece(void)
{
    const struct fb_sum nothing = {0.0f, 0.0f};
    struct fb_plan *plan = &power.plan;
    const bool was_injecting = power.piece.injecting;

    if (power.piece.averaged) {
        power.loop.base.x = power.loop.mean_d.total * plan->per_averaged;
        power.loop.base.y = power.loop.mean_q.total * plan->per_averaged;
    }
    power.k = 0;
    if (power.at < plan->count) {
        power.piece = plan->pieces[power.at];
        power.at++;
    } else if (power.at < plan->count + plan->trapezoid.corners) {
        fb_plan_edge(&plan->trapezoid, power.at - plan->count, &power.piece);
        power.at++;
    } else {
        finish();
        return;
    }
    power.loop.mean_d = nothing;
    power.loop.mean_q = nothing;
    if (power.piece.injecting && !was_injecting) {
        fb_start_injection(&power.loop);
    }
    if (power.piece.mode == FB_OFF) {
        power.loop.set_point = power.piece.start;
        power.loop.integral = power.piece.start; /* zero, both */
    }
    gates(power.piece.mode != FB_OFF);
    if (power.state == FLUXBENCH_STATE_RUNNING || power.is_recording) {
        power.phase = phase_of(&power.piece);
    }
}

static void start_plan(void)
{
    power.piece.averaged = false;
    power.piece.injecting = false;
    power.at = 0;
    next_piece();
}

/* Current to zero within milliseconds, then gates off. */
static void ramp_to_safety(void)
{
    const struct bounds *b = &power.bounds;
    const struct fb_vector from = power.loop.set_point;
    const struct fb_vector none = {0.0f, 0.0f};
    const float reach = b->safe_samples_per_a * fb_length(from);
    float ramp = reach > b->safe_samples ? reach : b->safe_samples;
    float per_ramp;

    ramp = ramp < b->safe_samples_most ? ramp : b->safe_samples_most;
    per_ramp = fb_reciprocal(ramp);
    memset(&power.plan, 0, sizeof(power.plan));
    power.tuning = b->safe;
    power.plan.count = 2;
    power.plan.pieces[0].mode = FB_CONTROL;
    power.plan.pieces[0].samples = (uint32_t)ramp;
    power.plan.pieces[0].start = from;
    power.plan.pieces[0].slope.x = -from.x * per_ramp;
    power.plan.pieces[0].slope.y = -from.y * per_ramp;
    power.plan.pieces[1].mode = FB_CONTROL;
    power.plan.pieces[1].samples = (uint32_t)ramp / 2u + 1u;
    power.plan.pieces[1].start = none;
    start_plan();
}

static void trip(uint8_t fault, float value, float limit, bool at_once)
{
    const uint16_t bit = (uint16_t)(1u << fault);
    const bool was_faulted = power.state == FLUXBENCH_STATE_FAULTED;

    if ((power.faults & bit) != 0u) {
        return;
    }
    if (power.faults == 0u) {
        power.cause = fault;
        power.fault_value = value;
        power.fault_limit = limit;
    }
    power.faults = (uint16_t)(power.faults | bit);
    give_up();
    power.state = FLUXBENCH_STATE_FAULTED;
    if (at_once || !power.gates) {
        off();
    } else if (!was_faulted) {
        ramp_to_safety();
    } else {
        /* on the way to the safe state already */
    }
}

/* What the sampling interrupt does */

/* Clarke's transform, amplitude-invariant, from two sensors or three. */
static struct fb_vector to_stator(const struct fb_reading *r)
{
    struct fb_vector i;

    if (fb_facts.has_third_sensor) {
        i.x = (2.0f * r->i_a - r->i_b - r->i_c) * (1.0f / 3.0f);
        i.y = (r->i_b - r->i_c) * PER_SQRT3;
    } else {
        i.x = r->i_a;
        i.y = (r->i_a + 2.0f * r->i_b) * PER_SQRT3;
    }
    return i;
}

/* Duties with the mean of the outer two in the middle, which reaches v_dc / sqrt(3) in every direction. */
static void apply(struct fb_vector v, float v_dc)
{
    const float half_b = 0.5f * 1.7320508f * v.y;
    const float v_a = v.x;
    const float v_b = half_b - 0.5f * v.x;
    const float v_c = -half_b - 0.5f * v.x;
    float most = v_a > v_b ? v_a : v_b;
    float least = v_a < v_b ? v_a : v_b;
    float per_v, middle;

    most = most > v_c ? most : v_c;
    least = least < v_c ? least : v_c;
    per_v = v_dc > 1.0f ? fb_reciprocal(v_dc) : 0.0f;
    middle = 0.5f - 0.5f * (most + least) * per_v;
    fb_board_duties(v_a * per_v + middle, v_b * per_v + middle, v_c * per_v + middle);
}

static bool is_beyond(float value, float span)
{
    return !(value <= span && value >= -span); /* NaN too */
}

static float third(const struct fb_reading *r)
{
    return fb_facts.has_third_sensor ? r->i_c : -r->i_a - r->i_b;
}

/* A broken sensor's reading is not computed with: it would stay in what is low-passed. */
static void require_plausible(struct fb_reading *r)
{
    const struct fb_reading nothing = {0.0f, 0.0f, 0.0f, 0.0f};
    const float span = fb_facts.sensor_span_a;

    if (is_beyond(r->i_a, span) || is_beyond(r->i_b, span) || is_beyond(third(r), span) ||
        is_beyond(r->v_dc, BUS_SPAN * fb_facts.dc_bus_v)) {
        trip(FLUXBENCH_FAULT_SENSOR, 0.0f, 0.0f, true);
        *r = nothing;
    }
}

/* Faults that open the gates at once. */
static void protect(float square)
{
    if (power.gates && square > power.bounds.trip_square) {
        trip(FLUXBENCH_FAULT_OVERCURRENT, square * fb_rsqrt(square), power.bounds.trip_a, true);
    } else if (power.gates && fb_board_gate_fault()) {
        trip(FLUXBENCH_FAULT_GATE_DRIVER, 0.0f, 0.0f, true);
    } else {
        power.spent_s += (square * power.bounds.per_rated_square - 1.0f) * sample_s;
        power.spent_s = power.spent_s > 0.0f ? power.spent_s : 0.0f;
        if (power.gates && power.spent_s > fb_facts.overload_s) {
            trip(FLUXBENCH_FAULT_OVERLOAD, power.spent_s, fb_facts.overload_s, false);
        }
    }
}

static void ask_watchdog(void)
{
    const uint32_t hungry_us = fb_board_time_us() - power.fed_us;

    if (power.watchdog_us > 0u && hungry_us > power.watchdog_us) {
        trip(FLUXBENCH_FAULT_WATCHDOG, 1e-6f * (float)hungry_us, fb_facts.watchdog_s, false);
    }
}

/* Faults that ramp down first. */
static void watch(const struct fb_reading *r, float square)
{
    const struct bounds *b = &power.bounds;
    const uint32_t armed_for = power.tick - power.armed_at;
    const uint32_t run_for = power.tick - power.begun_at;

    fb_add(&power.energy_j, b->watts_per_square * square * sample_s);
    ask_watchdog();
    if (b->energy_j > 0.0f && power.energy_j.total > b->energy_j) {
        trip(FLUXBENCH_FAULT_LIMIT, power.energy_j.total, b->energy_j, false);
    }
    if (armed_for > b->duration) {
        trip(FLUXBENCH_FAULT_LIMIT, (float)armed_for * sample_s, (float)b->duration * sample_s, false);
    }
    if (power.state == FLUXBENCH_STATE_RUNNING && run_for > power.due) {
        trip(FLUXBENCH_FAULT_PROGRAM_TOO_LONG, (float)run_for * sample_s, (float)power.due * sample_s, false);
    }
    if (r->v_dc < BUS_LOW * fb_facts.dc_bus_v) {
        trip(FLUXBENCH_FAULT_BUS_VOLTAGE, r->v_dc, BUS_LOW * fb_facts.dc_bus_v, false);
    } else if (r->v_dc > BUS_HIGH * fb_facts.dc_bus_v) {
        trip(FLUXBENCH_FAULT_BUS_VOLTAGE, r->v_dc, BUS_HIGH * fb_facts.dc_bus_v, false);
    } else {
        /* as it should be */
    }
}

/* The voltage of this sample in the believed frame. */
static struct fb_vector respond(struct fb_vector i, float v_dc, struct fb_injected *injected)
{
    const float reach = PER_SQRT3 * v_dc;
    const float most = power.bounds.most_v < reach ? power.bounds.most_v : reach;
    const struct fb_vector none = {0.0f, 0.0f};
    struct fb_vector v = none;

    if (power.piece.mode == FB_CONTROL) {
        v = fb_control(&power.loop, &power.tuning, &power.piece, power.k, i, most);
    } else if (power.piece.mode == FB_OPEN) {
        v = power.loop.base;
        if (power.piece.injecting) {
            *injected = fb_inject(&power.loop, &power.plan.wave);
            v.x += injected->volts.x;
            v.y += injected->volts.y;
        }
        v = fb_limited(v, most);
    } else {
        /* gates are off */
    }
    if (!(fb_square(v) <= MORE * most * most)) { /* NaN too: a nameplate that makes no control */
        trip(FLUXBENCH_FAULT_INTERNAL, 0.0f, 0.0f, true);
        v = none;
    }
    return v;
}

static void capture(const struct fb_reading *r, struct fb_vector i_ab, struct fb_vector v_ab)
{
    struct fb_row row;

    row.i_ab = i_ab;
    row.v_ab = v_ab;
    row.v_dc = r->v_dc;
    row.i_a = r->i_a;
    row.i_b = r->i_b;
    row.i_c = third(r);
    power.rows_left--;
    fb_capture_take(&row, power.tick);
}

void fb_sample(void)
{
    const struct fb_vector zero = {0.0f, 0.0f};
    struct fb_injected injected = {{0.0f, 0.0f}, 0.0f, 0.0f};
    struct fb_reading reading;
    struct fb_vector i_ab, i, v, v_ab;
    float square;

    fb_board_read(&reading);
    power.tick++;
    require_plausible(&reading);
    i_ab = to_stator(&reading);
    square = fb_square(i_ab);
    protect(square);
    if (fb_power_is_energised(power.state)) {
        watch(&reading, square);
    }
    fb_ripple_settle();
    i = fb_turned_back(i_ab, power.frame);
    v = respond(i, reading.v_dc, &injected);
    v_ab = power.gates ? fb_turned(v, power.frame) : zero;
    if (power.gates) {
        apply(v_ab, reading.v_dc);
    }
    power.shown.x += shown_step * (i.x - power.shown.x);
    power.shown.y += shown_step * (i.y - power.shown.y);
    power.v_dc = reading.v_dc;
    if (power.piece.averaged) {
        fb_add(&power.loop.mean_d, v.x);
        fb_add(&power.loop.mean_q, v.y);
    }
    if (power.piece.captured && power.rows_left > 0u) {
        capture(&reading, i_ab, v_ab);
        if (power.piece.injecting) {
            const struct fb_vector over = {v.x - power.loop.base.x, v.y - power.loop.base.y};

            fb_ripple_take(i, over, &injected, power.rows_left == 0u);
        }
    }
    power.k++;
    if (power.k >= power.piece.samples && power.piece.samples != FB_ENDLESS) {
        next_piece();
    }
}

/* What the main loop asks for */

static void reckon_bounds(void)
{
    const struct fb_nameplate motor = fb_nameplate();
    const float fs = fb_facts.sampling_hz;
    const float longest_l = motor.l_d_h > motor.l_q_h ? motor.l_d_h : motor.l_q_h;
    const float duration = fb_register(FLUXBENCH_REG_LIMIT_DURATION_S) * fs;
    struct bounds b;

    b.trip_a = fb_facts.trip_ratio * fb_register(FLUXBENCH_REG_LIMIT_CURRENT_A);
    b.trip_square = b.trip_a * b.trip_a;
    b.most_v = fb_register(FLUXBENCH_REG_LIMIT_VOLTAGE_V);
    b.per_rated_square = 1.0f / (motor.rated_a * motor.rated_a);
    b.energy_j = fb_register(FLUXBENCH_REG_LIMIT_ENERGY_J);
    b.duration = duration > 0.0f && duration < 4e9f ? (uint32_t)duration : FB_ENDLESS;
    b.watts_per_square = 1.5f * motor.resistance_ohm;
    b.safe = fb_tuned(SAFE_HZ < fs / 20.0f ? SAFE_HZ : fs / 20.0f, 0.70710678f);
    b.safe_samples = SAFE_RAMP_S * fs > 1.0f ? SAFE_RAMP_S * fs : 1.0f;
    b.safe_samples_most = SAFE_LONGEST_S * fs > 1.0f ? SAFE_LONGEST_S * fs : 1.0f;
    b.safe_samples_per_a = longest_l * fs / (SAFE_PART * b.most_v);
    fb_board_lock();
    power.bounds = b;
    fb_board_unlock();
}

static uint8_t refused_to_arm(void)
{
    uint8_t status = FLUXBENCH_ACK_OK;

    if (power.faults != 0u || power.state == FLUXBENCH_STATE_FAULTED) {
        status = FLUXBENCH_ACK_FAULT_LATCHED;
    } else if (power.state != FLUXBENCH_STATE_DISARMED) {
        status = FLUXBENCH_ACK_WRONG_STATE;
    } else if (!(fb_register(FLUXBENCH_REG_LIMIT_CURRENT_A) > 0.0f) ||
               !(fb_register(FLUXBENCH_REG_LIMIT_VOLTAGE_V) > 0.0f)) {
        status = FLUXBENCH_ACK_OUT_OF_RANGE;
    } else if (power.open_interlocks != 0u) {
        status = FLUXBENCH_ACK_INTERLOCK_OPEN;
    } else {
        status = FLUXBENCH_ACK_OK;
    }
    return status;
}

static struct fb_tuning tuning_asked_for(void)
{
    return fb_tuned(fb_register(FLUXBENCH_REG_CONTROL_BANDWIDTH_HZ), fb_register(FLUXBENCH_REG_CONTROL_DAMPING));
}

uint8_t fb_power_arm(void)
{
    const struct fb_sum nothing = {0.0f, 0.0f};
    uint8_t status = refused_to_arm();
    struct fb_tuning tuning;

    if (status != FLUXBENCH_ACK_OK) {
        return status;
    }
    reckon_bounds();
    tuning = tuning_asked_for();
    fb_board_lock();
    status = refused_to_arm(); /* a fault may have come meanwhile */
    if (status == FLUXBENCH_ACK_OK) {
        power.tuning = tuning;
        power.fed_us = fb_board_time_us();
        power.armed_at = power.tick;
        power.energy_j = nothing;
        power.off_after = false;
        power.phase = FLUXBENCH_PHASE_IDLE;
        power.state = FLUXBENCH_STATE_HOLDING;
        off(); /* zero current, zero integrals */
        hold_for_good(FB_CONTROL);
        gates(true);
    }
    fb_board_unlock();
    return status;
}

static uint8_t refused_to_run(void)
{
    uint8_t status = FLUXBENCH_ACK_OK;

    if (power.state == FLUXBENCH_STATE_FAULTED) {
        status = FLUXBENCH_ACK_FAULT_LATCHED;
    } else if (power.state != FLUXBENCH_STATE_HOLDING) {
        status = FLUXBENCH_ACK_WRONG_STATE;
    } else {
        status = FLUXBENCH_ACK_OK;
    }
    return status;
}

/* Turn what the loop remembers into another frame: the voltages stay what they are. */
static void believe(struct fb_vector frame)
{
    struct fb_loop *loop = &power.loop;

    loop->set_point = fb_turned_back(fb_turned(loop->set_point, power.frame), frame);
    loop->integral = fb_turned_back(fb_turned(loop->integral, power.frame), frame);
    power.frame = frame;
}

/* Begin what next_plan holds; `state` is the state meanwhile. */
static uint8_t begin(uint8_t state, const struct fb_tuning *tuning, struct fb_vector frame)
{
    uint8_t status;

    fb_board_lock();
    status = refused_to_run();
    if (status == FLUXBENCH_ACK_OK) {
        believe(frame);
        power.plan = next_plan;
        power.tuning = *tuning;
        power.state = state;
        power.is_recording = state == FLUXBENCH_STATE_HOLDING;
        power.off_after = next_plan.off_after;
        power.begun_at = power.tick;
        power.due = next_plan.samples + 1u;
        power.rows_left = next_plan.rows;
        start_plan();
    }
    fb_board_unlock();
    return status;
}

uint8_t fb_power_run(void)
{
    const struct fb_vector frame = fb_direction(fb_turn_of(fb_register(FLUXBENCH_REG_ROTOR_ANGLE_RAD)));
    const struct fb_tuning tuning = tuning_asked_for();
    uint8_t status = refused_to_run();

    if (status == FLUXBENCH_ACK_OK) {
        const struct fb_vector from = fb_turned_back(fb_turned(power.loop.set_point, power.frame), frame);

        status = fb_plan_program(&next_plan, from);
    }
    if (status == FLUXBENCH_ACK_OK && power.is_recording) {
        status = FLUXBENCH_ACK_WRONG_STATE;
    }
    if (status == FLUXBENCH_ACK_OK) {
        status = fb_ripple_allot(&next_plan);
    }
    if (status == FLUXBENCH_ACK_OK) {
        status = fb_capture_allot(next_plan.rows);
    }
    if (status == FLUXBENCH_ACK_OK) {
        recorded_rows = 0;
        status = begin(FLUXBENCH_STATE_RUNNING, &tuning, frame);
    }
    return status;
}

uint8_t fb_power_record_arm(uint32_t rows)
{
    uint8_t status = refused_to_run();

    if (status == FLUXBENCH_ACK_OK && power.is_recording) {
        status = FLUXBENCH_ACK_WRONG_STATE;
    }
    if (status == FLUXBENCH_ACK_OK && (rows < 1u || rows > FLUXBENCH_MOST_ROWS)) {
        status = FLUXBENCH_ACK_OUT_OF_RANGE;
    }
    if (status == FLUXBENCH_ACK_OK) {
        fb_plan_still(&next_plan, FB_CONTROL, power.loop.set_point, rows, true);
        (void)fb_ripple_allot(&next_plan); /* none */
        status = fb_capture_allot(rows);
    }
    recorded_rows = status == FLUXBENCH_ACK_OK ? rows : recorded_rows;
    return status;
}

uint8_t fb_power_record(void)
{
    uint8_t status = refused_to_run();

    if (status == FLUXBENCH_ACK_OK && recorded_rows == 0u) {
        status = FLUXBENCH_ACK_WRONG_STATE;
    }
    if (status == FLUXBENCH_ACK_OK) {
        const enum fb_mode mode = power.off_after ? FB_OFF : FB_CONTROL;

        fb_plan_still(&next_plan, mode, power.loop.set_point, recorded_rows, true);
        next_plan.off_after = power.off_after;
        recorded_rows = 0;
        status = begin(FLUXBENCH_STATE_HOLDING, &power.tuning, power.frame);
    }
    return status;
}

void fb_power_stop(void)
{
    fb_plan_to_zero(&next_plan, power.loop.set_point);
    fb_board_lock();
    if (fb_power_is_energised(power.state) && power.state != FLUXBENCH_STATE_STOPPING) {
        const bool is_off = power.off_after && power.state == FLUXBENCH_STATE_HOLDING;

        give_up();
        if (is_off) {
            hold_for_good(FB_OFF);
        } else {
            power.plan = next_plan;
            power.off_after = false;
            power.state = FLUXBENCH_STATE_STOPPING;
            start_plan();
        }
    }
    fb_board_unlock();
}

void fb_power_disarm(void)
{
    fb_board_lock();
    give_up();
    off();
    if (power.state != FLUXBENCH_STATE_FAULTED) {
        power.state = FLUXBENCH_STATE_DISARMED;
    }
    fb_board_unlock();
}

void fb_power_clear(void)
{
    fb_board_lock();
    if (power.state == FLUXBENCH_STATE_FAULTED) {
        off();
        power.state = FLUXBENCH_STATE_DISARMED;
    }
    power.cause = FLUXBENCH_FAULT_NONE;
    power.faults = 0;
    power.fault_value = 0.0f;
    power.fault_limit = 0.0f;
    fb_board_unlock();
}

void fb_power_feed(void)
{
    fb_board_lock();
    power.fed_us = fb_board_time_us();
    fb_board_unlock();
}

void fb_power_trip(uint8_t fault, float value, float limit)
{
    fb_board_lock();
    trip(fault, value, limit, false);
    fb_board_unlock();
}

void fb_power_guard(void)
{
    const uint8_t open = fb_facts.has_interlocks ? fb_board_interlocks() : (uint8_t)0u;

    fb_board_lock();
    power.open_interlocks = open;
    if (fb_power_is_energised(power.state)) {
        ask_watchdog();
        if (open != 0u) {
            trip(FLUXBENCH_FAULT_INTERLOCK, (float)open, 0.0f, false);
        }
    }
    fb_board_unlock();
    if (fb_facts.has_thermometer) {
        const float celsius = fb_board_temperature_c();

        fb_register_set(FLUXBENCH_REG_TEMPERATURE_C, celsius);
        if (celsius > fb_facts.hottest_c && fb_power_is_energised(power.state)) {
            fb_power_trip(FLUXBENCH_FAULT_OVERTEMPERATURE, celsius, fb_facts.hottest_c);
        }
    }
}
