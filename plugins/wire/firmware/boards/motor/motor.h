/* A permanent-magnet motor with saturation on a locked rotor, behind an ideal bridge: something for the firmware to
   drive where there is no bench. 400 W, as in the procedure `demo`; a model of its own, that no analysis knows. */

#ifndef MOTOR_H
#define MOTOR_H

#include <stdbool.h>
#include <stdint.h>

#define MOTOR_BUS_V 400.0f
#define MOTOR_RESISTANCE_OHM 4.4f

struct motor {
    float psi_d, psi_q; /* flux linkage over the magnets' [Wb] */
    float duty_a, duty_b, duty_c;
    float next_a, next_b, next_c; /* as with a PWM whose compare registers are shadowed */
    bool gates;
    uint32_t chance;
};

void motor_init(struct motor *motor);

/* Phase currents as two sensors of 12 bits over +-16 A read them. */
void motor_read(struct motor *motor, float *i_a, float *i_b);

void motor_set_duties(struct motor *motor, float a, float b, float c);

/* A sampling period passes. */
void motor_pass(struct motor *motor, float seconds);

#endif
