#include "motor.h"

#define L_D_H 0.0435f
#define L_Q_H 0.0690f
#define SATURATION_D 60.0f  /* A/Wb^3: i_d = x / L_d + a x^3 + c x y^2 */
#define SATURATION_Q 35.0f
#define CROSS 25.0f
#define QUANTUM_A (32.0f / 4096.0f)
#define STEPS 4
#define SQRT3 1.73205081f

struct pair {
    float d, q;
};

void motor_init(struct motor *motor)
{
    const struct motor fresh = {0.0f, 0.0f, 0.5f, 0.5f, 0.5f, 0.5f, 0.5f, 0.5f, false, 1u};

    *motor = fresh;
}

/* Gradient of an energy, so that the cross terms are reciprocal. */
static struct pair current_of(float x, float y)
{
    const struct pair i = {
        x / L_D_H + SATURATION_D * x * x * x + CROSS * x * y * y,
        y / L_Q_H + SATURATION_Q * y * y * y + CROSS * y * x * x,
    };

    return i;
}

/* Uniform in +-1. */
static float chance(struct motor *motor)
{
    motor->chance = motor->chance * 1664525u + 1013904223u;
    return (float)(int32_t)motor->chance * 4.6566129e-10f;
}

static float sensed(struct motor *motor, float amperes)
{
    const float counts = (amperes + 0.004f * (chance(motor) + chance(motor))) / QUANTUM_A;

    return (float)(int32_t)(counts + (counts < 0.0f ? -0.5f : 0.5f)) * QUANTUM_A;
}

void motor_read(struct motor *motor, float *i_a, float *i_b)
{
    const struct pair i = current_of(motor->psi_d, motor->psi_q);

    *i_a = sensed(motor, i.d);
    *i_b = sensed(motor, -0.5f * i.d + 0.5f * SQRT3 * i.q);
}

void motor_set_duties(struct motor *motor, float a, float b, float c)
{
    motor->next_a = a;
    motor->next_b = b;
    motor->next_c = c;
}

static struct pair slope(float x, float y, float v_d, float v_q)
{
    const struct pair i = current_of(x, y);
    const struct pair rate = {v_d - MOTOR_RESISTANCE_OHM * i.d, v_q - MOTOR_RESISTANCE_OHM * i.q};

    return rate;
}

/* With the gates open the diodes put the bus against the current until there is none. */
static void drain(struct motor *motor, float seconds)
{
    const float most = 0.5f * MOTOR_BUS_V * seconds;

    motor->psi_d -= motor->psi_d > most ? most : (motor->psi_d < -most ? -most : motor->psi_d);
    motor->psi_q -= motor->psi_q > most ? most : (motor->psi_q < -most ? -most : motor->psi_q);
}

void motor_pass(struct motor *motor, float seconds)
{
    const float h = seconds / (float)STEPS;
    const float v_d = MOTOR_BUS_V * (2.0f * motor->duty_a - motor->duty_b - motor->duty_c) / 3.0f;
    const float v_q = MOTOR_BUS_V * (motor->duty_b - motor->duty_c) / SQRT3;

    if (motor->gates) {
        for (int step = 0; step < STEPS; step++) { /* the midpoint rule */
            const struct pair here = slope(motor->psi_d, motor->psi_q, v_d, v_q);
            const struct pair there =
                slope(motor->psi_d + 0.5f * h * here.d, motor->psi_q + 0.5f * h * here.q, v_d, v_q);

            motor->psi_d += h * there.d;
            motor->psi_q += h * there.q;
        }
    } else {
        drain(motor, seconds);
    }
    motor->duty_a = motor->next_a;
    motor->duty_b = motor->next_b;
    motor->duty_c = motor->next_c;
}
