#include "fb_plan.h"

#include <string.h>

#include "fb_board.h"
#include "fb_registers.h"
#include "fluxbench_registers.h"

#define PI_F 3.14159265f
#define HALF_SQRT2 0.70710678f
#define DRAIN_S 0.02f       /* for the diodes to bring a residual current to zero */
#define RAMP_PART 0.3f      /* of the voltage limit that a ramp may take */
#define WIRE_SLACK 1.000001f /* numbers went over a wire as singles */
#define MOST_PERIODS 2000.0f
#define MOST_SAMPLES 4.0e9

static const uint8_t corner_at[] = {0u, 1u, 3u, 5u, 7u, 8u};
static const int8_t corner_level[] = {0, 1, 1, -1, -1, 0};
#define EDGES 5u

static uint32_t samples_in(double seconds)
{
    const double samples = seconds * (double)fb_facts.sampling_hz;

    return samples < MOST_SAMPLES ? (uint32_t)(samples + 0.5) : FB_ENDLESS;
}

static float told(uint8_t index, float own)
{
    const float host = fb_register(index);

    return host > 0.0f ? host : own;
}

struct fb_nameplate fb_nameplate(void)
{
    const struct fb_nameplate nameplate = {
        told(FLUXBENCH_REG_MOTOR_RESISTANCE_OHM, fb_facts.resistance_ohm),
        told(FLUXBENCH_REG_MOTOR_INDUCTANCE_D_H, fb_facts.l_d_h),
        told(FLUXBENCH_REG_MOTOR_INDUCTANCE_Q_H, fb_facts.l_q_h),
        told(FLUXBENCH_REG_MOTOR_RATED_CURRENT_A, fb_facts.rated_a),
    };

    return nameplate;
}

/* Pole placement, s^2 + 2 zeta w s + w^2, where the motor is slower than that; else its own pole is cancelled. */
static void tune_axis(float w, float damping, float r, float l, float *proportional, float *integral)
{
    const float placed = 2.0f * damping * w * l - r;

    if (placed >= 0.5f * w * l) {
        *proportional = placed;
        *integral = w * w * l / fb_facts.sampling_hz;
    } else {
        *proportional = w * l;
        *integral = w * r / fb_facts.sampling_hz;
    }
}

struct fb_tuning fb_tuned(float bandwidth_hz, float damping)
{
    const struct fb_nameplate motor = fb_nameplate();
    const float w = 2.0f * PI_F * bandwidth_hz;
    struct fb_tuning tuning;

    tune_axis(w, damping, motor.resistance_ohm, motor.l_d_h, &tuning.proportional.x, &tuning.integral.x);
    tune_axis(w, damping, motor.resistance_ohm, motor.l_q_h, &tuning.proportional.y, &tuning.integral.y);
    tuning.per_proportional.x = 1.0f / tuning.proportional.x;
    tuning.per_proportional.y = 1.0f / tuning.proportional.y;
    tuning.inductance.x = motor.l_d_h * fb_facts.sampling_hz;
    tuning.inductance.y = motor.l_q_h * fb_facts.sampling_hz;
    tuning.resistance_ohm = motor.resistance_ohm;
    return tuning;
}

/* Pieces */

static void add(struct fb_plan *plan, struct fb_piece piece)
{
    if (piece.samples > 0u && plan->count < FB_MOST_PIECES) {
        plan->pieces[plan->count] = piece;
        plan->count++;
        plan->samples += piece.samples;
    }
}

static struct fb_piece still(enum fb_mode mode, struct fb_vector at, uint32_t samples)
{
    const struct fb_piece piece = {mode, samples, at, {0.0f, 0.0f}, false, false, false};

    return piece;
}

static void add_ramp(struct fb_plan *plan, struct fb_vector from, struct fb_vector to, uint32_t samples)
{
    struct fb_piece piece = still(FB_CONTROL, from, samples);

    if (samples > 0u) {
        piece.slope.x = (to.x - from.x) / (float)samples;
        piece.slope.y = (to.y - from.y) / (float)samples;
    }
    add(plan, piece);
}

/* Two time constants of the closed loop, or longer where the voltage does not reach. */
static uint32_t ramp_samples(struct fb_vector from, struct fb_vector to)
{
    const struct fb_nameplate motor = fb_nameplate();
    const struct fb_vector change = {to.x - from.x, to.y - from.y};
    const float longest_l = motor.l_d_h > motor.l_q_h ? motor.l_d_h : motor.l_q_h;
    const float reach_s = longest_l * fb_length(change) / (RAMP_PART * fb_register(FLUXBENCH_REG_LIMIT_VOLTAGE_V));
    const float loop_s = 1.0f / (PI_F * fb_register(FLUXBENCH_REG_CONTROL_BANDWIDTH_HZ));

    return fb_square(change) > 0.0f ? samples_in((double)(reach_s > loop_s ? reach_s : loop_s)) : 0u;
}

static void add_settling(struct fb_plan *plan, struct fb_vector from, struct fb_vector to, uint32_t samples)
{
    const uint32_t needed = ramp_samples(from, to);
    const uint32_t ramp = needed < samples / 2u ? needed : samples / 2u;

    add_ramp(plan, from, to, ramp);
    add(plan, still(FB_CONTROL, to, samples - ramp));
}

static void add_captured(struct fb_plan *plan, struct fb_piece piece)
{
    piece.captured = true;
    plan->rows = piece.samples;
    add(plan, piece);
}

void fb_plan_still(struct fb_plan *plan, enum fb_mode mode, struct fb_vector at, uint32_t samples, bool captured)
{
    memset(plan, 0, sizeof(*plan));
    if (captured) {
        add_captured(plan, still(mode, at, samples));
    } else {
        add(plan, still(mode, at, samples));
    }
}

void fb_plan_to_zero(struct fb_plan *plan, struct fb_vector from)
{
    const struct fb_vector zero = {0.0f, 0.0f};

    memset(plan, 0, sizeof(*plan));
    add_ramp(plan, from, zero, ramp_samples(from, zero));
    add(plan, still(FB_CONTROL, zero, samples_in(4.0 / (double)fb_register(FLUXBENCH_REG_CONTROL_BANDWIDTH_HZ))));
}

/* The four programs */

static double seconds(uint8_t index)
{
    return (double)fb_register(index);
}

static void plan_gates_off(struct fb_plan *plan, struct fb_vector from)
{
    const struct fb_vector zero = {0.0f, 0.0f};

    fb_plan_to_zero(plan, from);
    add(plan, still(FB_OFF, zero, samples_in((double)DRAIN_S)));
    add_captured(plan, still(FB_OFF, zero, samples_in(seconds(FLUXBENCH_REG_DURATION_S))));
    plan->off_after = true;
}

static void plan_hold(struct fb_plan *plan, struct fb_vector from, struct fb_vector target)
{
    add_settling(plan, from, target, samples_in(seconds(FLUXBENCH_REG_SETTLE_S)));
    add_captured(plan, still(FB_CONTROL, target, samples_in(seconds(FLUXBENCH_REG_DURATION_S))));
}

static struct fb_vector swept_direction(void)
{
    const struct fb_vector directions[] = {{1.0f, 0.0f}, {0.0f, 1.0f}, {HALF_SQRT2, HALF_SQRT2}};

    return directions[fb_register_whole(FLUXBENCH_REG_SWEPT_AXIS)];
}

static struct fb_vector trapezoid_origin(void)
{
    const float held = fb_register(FLUXBENCH_REG_HELD_A);
    const struct fb_vector origins[] = {{0.0f, held}, {held, 0.0f}, {0.0f, 0.0f}};

    return origins[fb_register_whole(FLUXBENCH_REG_SWEPT_AXIS)];
}

static uint32_t rounded(uint64_t samples) /* in 2^-32 */
{
    return (uint32_t)((samples + 0x80000000u) >> 32);
}

static void plan_trapezoid(struct fb_plan *plan, struct fb_vector from)
{
    const struct fb_vector direction = swept_direction();
    const float amplitude = fb_register(FLUXBENCH_REG_AMPLITUDE_A);
    const double eighth = seconds(FLUXBENCH_REG_PERIOD_S) * (double)fb_facts.sampling_hz / 8.0;
    struct fb_trapezoid *trapezoid = &plan->trapezoid;

    trapezoid->origin = trapezoid_origin();
    add_settling(plan, from, trapezoid->origin, samples_in(seconds(FLUXBENCH_REG_SETTLE_S)));
    trapezoid->amplitude.x = amplitude * direction.x;
    trapezoid->amplitude.y = amplitude * direction.y;
    trapezoid->eighth = ((uint64_t)(uint32_t)eighth << 32) + (fb_phase(eighth) >> 32);
    trapezoid->per_sample = (float)(1.0 / eighth);
    trapezoid->corners = EDGES * fb_register_whole(FLUXBENCH_REG_PERIODS);
    plan->rows = rounded(trapezoid->eighth * (8u * fb_register_whole(FLUXBENCH_REG_PERIODS)));
    plan->samples += plan->rows;
}

static void plan_injection(struct fb_plan *plan, struct fb_vector from, struct fb_vector target)
{
    const double fs = (double)fb_facts.sampling_hz;
    const double cycles = seconds(FLUXBENCH_REG_FREQUENCY_HZ) / fs;
    uint32_t settle = samples_in(seconds(FLUXBENCH_REG_SETTLE_S));
    struct fb_piece piece;

    settle = settle < 2u ? 2u : settle;
    add_settling(plan, from, target, settle - settle / 2u);
    piece = still(FB_CONTROL, target, settle / 2u);
    piece.averaged = true;
    plan->per_averaged = 1.0f / (float)piece.samples;
    add(plan, piece);
    add(plan, still(FB_OPEN, target, samples_in(0.25 / seconds(FLUXBENCH_REG_CONTROL_BANDWIDTH_HZ))));
    piece = still(FB_OPEN, target, samples_in(seconds(FLUXBENCH_REG_DISCARD_S)));
    piece.injecting = true;
    add(plan, piece);
    piece.samples = samples_in(seconds(FLUXBENCH_REG_DURATION_S));
    add_captured(plan, piece);
    plan->wave.amplitude_v = fb_register(FLUXBENCH_REG_AMPLITUDE_V);
    plan->wave.square = fb_register_whole(FLUXBENCH_REG_WAVEFORM) == (uint32_t)FLUXBENCH_WAVEFORM_SQUARE;
    plan->wave.cycles = fb_phase(cycles);
    plan->wave.turns = fb_phase(seconds(FLUXBENCH_REG_ROTATION_HZ) / fs);
    plan->wave.delay = fb_phase((double)fb_facts.voltage_delay_samples * cycles);
}

/* Edge `edge` of all; begins and ends are rounded from the exact corners, so that periods do not drift. */
void fb_plan_edge(struct fb_trapezoid *trapezoid, uint32_t edge, struct fb_piece *piece)
{
    const uint32_t period = edge / EDGES;
    const uint32_t k = edge - EDGES * period;
    const uint64_t begin = trapezoid->eighth * (8u * period + corner_at[k]);
    const uint64_t end = trapezoid->eighth * (8u * period + corner_at[k + 1u]);
    const uint32_t first = rounded(begin);
    const float early = (float)(int32_t)(((uint64_t)first << 32) - begin) * 2.3283064e-10f; /* 2^-32 */
    const float wide = (k == 2u) ? 0.5f : 1.0f; /* from +A to -A in two eighths, else A in one */
    const float rise = (float)(corner_level[k + 1u] - corner_level[k]) * wide * trapezoid->per_sample;
    const float level = (float)corner_level[k] + rise * early;

    piece->mode = FB_CONTROL;
    piece->samples = rounded(end) - first;
    piece->start.x = trapezoid->origin.x + trapezoid->amplitude.x * level;
    piece->start.y = trapezoid->origin.y + trapezoid->amplitude.y * level;
    piece->slope.x = trapezoid->amplitude.x * rise;
    piece->slope.y = trapezoid->amplitude.y * rise;
    piece->captured = true;
    piece->averaged = false;
    piece->injecting = false;
}

/* What is refused */

static bool is_positive(uint8_t index)
{
    return fb_register(index) > 0.0f;
}

static bool makes_a_program(uint32_t kind)
{
    bool does = is_positive(FLUXBENCH_REG_DURATION_S);

    if (kind == (uint32_t)FLUXBENCH_KIND_TRAPEZOID) {
        does = is_positive(FLUXBENCH_REG_AMPLITUDE_A) && is_positive(FLUXBENCH_REG_PERIOD_S) &&
               is_positive(FLUXBENCH_REG_PERIODS);
    } else if (kind == (uint32_t)FLUXBENCH_KIND_INJECTION) {
        does = does && is_positive(FLUXBENCH_REG_SETTLE_S) && is_positive(FLUXBENCH_REG_AMPLITUDE_V) &&
               is_positive(FLUXBENCH_REG_FREQUENCY_HZ) &&
               fb_register(FLUXBENCH_REG_FREQUENCY_HZ) <= 0.5f * fb_facts.sampling_hz &&
               fb_register(FLUXBENCH_REG_ROTATION_HZ) <= 0.5f * fb_facts.sampling_hz;
    }
    return does && fb_register(FLUXBENCH_REG_CONTROL_BANDWIDTH_HZ) <= 0.1f * fb_facts.sampling_hz;
}

static double length_s(uint32_t kind)
{
    double length = seconds(FLUXBENCH_REG_DURATION_S);

    if (kind == (uint32_t)FLUXBENCH_KIND_TRAPEZOID) {
        length = seconds(FLUXBENCH_REG_PERIOD_S) * (double)fb_register(FLUXBENCH_REG_PERIODS);
    } else if (kind == (uint32_t)FLUXBENCH_KIND_INJECTION) {
        length += seconds(FLUXBENCH_REG_DISCARD_S);
    }
    return kind == (uint32_t)FLUXBENCH_KIND_GATES_OFF ? length : length + seconds(FLUXBENCH_REG_SETTLE_S);
}

static struct fb_vector target_of(uint32_t kind)
{
    struct fb_vector target = {0.0f, 0.0f};

    if (kind == (uint32_t)FLUXBENCH_KIND_TRAPEZOID) {
        target = trapezoid_origin();
    } else if (kind != (uint32_t)FLUXBENCH_KIND_GATES_OFF) {
        target.x = fb_register(FLUXBENCH_REG_CURRENT_D_A);
        target.y = fb_register(FLUXBENCH_REG_CURRENT_Q_A);
    }
    return target;
}

static bool is_within_limits(uint32_t kind)
{
    const float most_a = WIRE_SLACK * fb_register(FLUXBENCH_REG_LIMIT_CURRENT_A);
    const float most_v = WIRE_SLACK * fb_register(FLUXBENCH_REG_LIMIT_VOLTAGE_V);
    const float held_a = fb_length(target_of(kind));
    float longest_a = held_a;
    float longest_v = 0.0f;

    if (kind == (uint32_t)FLUXBENCH_KIND_TRAPEZOID) {
        const struct fb_vector corner = {held_a, fb_register(FLUXBENCH_REG_AMPLITUDE_A)};

        longest_a = fb_length(corner);
    } else if (kind == (uint32_t)FLUXBENCH_KIND_INJECTION) { /* on open loop: current control saturates by itself */
        longest_v = fb_register(FLUXBENCH_REG_AMPLITUDE_V) + fb_nameplate().resistance_ohm * held_a;
    }
    return longest_a <= most_a && longest_v <= most_v;
}

static uint8_t judge(uint32_t kind)
{
    const float pwm_hz = fb_register(FLUXBENCH_REG_PWM_FREQUENCY_ASKED_HZ);
    uint8_t status = FLUXBENCH_ACK_OK;

    if (!makes_a_program(kind)) {
        status = FLUXBENCH_ACK_OUT_OF_RANGE;
    } else if (length_s(kind) > (double)(WIRE_SLACK * fb_facts.longest_program_s) ||
               fb_register(FLUXBENCH_REG_PERIODS) > MOST_PERIODS) {
        status = FLUXBENCH_ACK_TOO_LONG;
    } else if (pwm_hz > 0.0f && (pwm_hz < fb_facts.pwm_hz || pwm_hz > fb_facts.pwm_hz)) {
        status = FLUXBENCH_ACK_NOT_SUPPORTED;
    } else if (!is_within_limits(kind)) {
        status = FLUXBENCH_ACK_PAST_LIMIT;
    } else {
        status = FLUXBENCH_ACK_OK;
    }
    return status;
}

uint8_t fb_plan_program(struct fb_plan *plan, struct fb_vector from)
{
    const uint32_t kind = fb_register_whole(FLUXBENCH_REG_PROGRAM_KIND);
    const uint8_t status = judge(kind);

    memset(plan, 0, sizeof(*plan));
    if (status != FLUXBENCH_ACK_OK) {
        return status;
    }
    if (kind == (uint32_t)FLUXBENCH_KIND_GATES_OFF) {
        plan_gates_off(plan, from);
    } else if (kind == (uint32_t)FLUXBENCH_KIND_HOLD) {
        plan_hold(plan, from, target_of(kind));
    } else if (kind == (uint32_t)FLUXBENCH_KIND_TRAPEZOID) {
        plan_trapezoid(plan, from);
    } else {
        plan_injection(plan, from, target_of(kind));
    }
    return plan->rows > 0u ? FLUXBENCH_ACK_OK : FLUXBENCH_ACK_OUT_OF_RANGE;
}
