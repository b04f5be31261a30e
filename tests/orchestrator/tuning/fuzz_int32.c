/* Calls the functions in int32 with words of every size, and leaves with 1 where a result breaks its promise.
 * Compiled so that a signed overflow or a bad shift ends the program. */
#include "motor_drive_int32.h"

#include <stdio.h>

enum { ROUNDS = 300000, SLACK_UV = 4 };

static uint32_t seed = 1u;

static uint32_t next(void)
{
    seed = seed * 1664525u + 1013904223u;
    return seed >> 8;
}

/* Any word, with as many small ones as large ones; an end of int32 now and then. */
static int32_t word(void)
{
    const uint32_t bits = (next() << 16) ^ next(), kind = next() % 40u;
    if (kind == 0u)
        return INT32_MIN;
    if (kind == 1u)
        return INT32_MAX;
    const int64_t value = (int64_t)(bits >> (kind % 32u));
    return (int32_t)((next() & 1u) ? -value / 2 : value / 2);
}

int main(void)
{
    motor_current_control_int32 state;
    motor_current_control_int32_init(&state);
    for (int n = 0; n < ROUNDS; n++) {
        int32_t i_ref[2] = {word(), word()}, i[2] = {word(), word()}, v[2], psi[2], l[3], read[2];
        const int32_t omega = word(), v_dc = word(), r_s = word();
        const int report = motor_current_control_uv(&state, i_ref, i, omega, v_dc, r_s, v);
        const double circle = (double)v_dc * (double)v_dc / 3.0, length = (double)v[0] * v[0] + (double)v[1] * v[1];
        const double slack = 2.0 * SLACK_UV * (double)(v_dc > 0 ? v_dc : 1) + SLACK_UV * SLACK_UV;
        if (report == MOTOR_INVALID ? v[0] != 0 || v[1] != 0 : v_dc <= 0 || length > circle + slack) {
            printf("voltage %d %d of %d, report %d\n", v[0], v[1], v_dc, report);
            return 1;
        }
        const int32_t torque = word(), limit = motor_torque_limit_unm(omega, v_dc, r_s);
        motor_current_reference_ua(torque, omega, v_dc, r_s, i_ref);
        const double reference = (double)i_ref[0] * i_ref[0] + (double)i_ref[1] * i_ref[1];
        if (limit < 0 || reference > 1.002 * (double)MOTOR_CURRENT_LIMIT_UA * MOTOR_CURRENT_LIMIT_UA) {
            printf("reference %d %d, limit %d\n", i_ref[0], i_ref[1], limit);
            return 1;
        }
        motor_psi_nwb(i[0], i[1], psi);
        motor_inductance_nh(i[0], i[1], l);
        motor_corrected_current_ua(i, read);
        motor_add_bias_uv(read);
        if (motor_r_s_uohm(word()) <= 0)
            return 1;
        motor_leg_voltage_uv(word(), v_dc);
        motor_angle_turn32((uint32_t)word(), omega);
        motor_angle_ahead_turn32((uint32_t)word(), omega);
    }
    return 0;
}
