/* A saturated machine behind an inverter, under the control of motor_drive.c; see closed_loop.py.
 *
 * Flux linkage is the state, in the frame of the stator; the current follows by Newton's iteration from an analytic
 * co-energy. The inverter is averaged over a PWM period and loses voltage by the sign of its currents. A voltage
 * computed from one sample acts from the next to the one after. Runge-Kutta of fourth order, ten steps in a period.
 */
#include "motor_drive.h"

#include <math.h>
#include <stdint.h>

#define SUBSTEPS 10
#define SQRT_3 1.7320508075688772

typedef struct {
    double psi_m, l_d, i_d, l_q, i_q, l_leak, cross, i_x, i_y;
    double r_s, pole_pairs;
    double v_dc, period, dead_time, drop_v, drop_ohm, knee_a;
    double gain_a, gain_b, offset_a, offset_b, noise_a;
    double angle_error;             /* believed angle = true - angle_error */
    double inertia, load_nm;        /* no inertia: the speed is imposed */
    double is_compensated, injected_v, injected_rad_per_sample, injected_axis;
    double winding_c;               /* what the code is told */
} plant;

enum { I_D, I_Q, TORQUE, OMEGA, V_D, V_Q, REF_D, REF_Q, REPORT, PHASE_A, INJECTED, LENGTH_V, COLUMNS };

/* psi(i) and its slopes L_dd, L_dq, L_qq, from the co-energy W = psi_m i_d + A(i_d) + B(i_q) - cross g(i_d) h(i_q). */
void plant_flux(const plant *p, double d, double q, double psi[2], double l[3])
{
    const double a = 1.0 + d * d / (p->i_d * p->i_d), b = 1.0 + q * q / (p->i_q * p->i_q);
    const double x = 1.0 + d * d / (p->i_x * p->i_x), y = 1.0 + q * q / (p->i_y * p->i_y);
    const double g = d / sqrt(x), g1 = 1.0 / (x * sqrt(x)), g2 = -3.0 * d / (p->i_x * p->i_x) * g1 / x;
    const double h = 0.5 * q * q / y, h1 = q / (y * y), h2 = (1.0 - 3.0 * q * q / (p->i_y * p->i_y)) / (y * y * y);
    psi[0] = p->psi_m + p->l_d * d / sqrt(a) - p->cross * g1 * h;
    psi[1] = p->l_q * q / sqrt(b) + p->l_leak * q - p->cross * g * h1;
    l[0] = p->l_d / (a * sqrt(a)) - p->cross * g2 * h;
    l[1] = -p->cross * g1 * h1;
    l[2] = p->l_q / (b * sqrt(b)) + p->l_leak - p->cross * g * h2;
}

/* i(psi), from a start that is near. */
static void current_of(const plant *p, const double psi[2], double i[2])
{
    for (int k = 0; k < 30; k++) {
        double at[2], l[3];
        plant_flux(p, i[0], i[1], at, l);
        const double d = psi[0] - at[0], q = psi[1] - at[1], det = l[0] * l[2] - l[1] * l[1];
        i[0] += (l[2] * d - l[1] * q) / det;
        i[1] += (l[0] * q - l[1] * d) / det;
        if (fabs(d) + fabs(q) < 1e-13)
            return;
    }
}

double plant_lost_v(const plant *p, double i, double v_dc)
{
    const double sign = fmax(-1.0, fmin(1.0, i / p->knee_a));
    return sign * (p->dead_time / p->period * v_dc + p->drop_v) + p->drop_ohm * i;
}

static void phases_of(const double ab[2], double abc[3])
{
    abc[0] = ab[0];
    abc[1] = -0.5 * ab[0] + 0.5 * SQRT_3 * ab[1];
    abc[2] = -0.5 * ab[0] - 0.5 * SQRT_3 * ab[1];
}

static void turn(const double x[2], double angle, double y[2])
{
    const double c = cos(angle), s = sin(angle), first = x[0];
    y[0] = c * first - s * x[1];
    y[1] = s * first + c * x[1];
}

/* y = psi_alpha, psi_beta, theta, omega; `i` holds the last current as the start of the iteration. */
static void slope(const plant *p, const double y[4], const double leg[3], double i[2], double result[4])
{
    double psi[2], ab[2], abc[3], v[3];
    turn(y, -y[2], psi);
    current_of(p, psi, i);
    turn(i, y[2], ab);
    phases_of(ab, abc);
    for (int k = 0; k < 3; k++)
        v[k] = leg[k] - plant_lost_v(p, abc[k], p->v_dc);
    const double torque = 1.5 * p->pole_pairs * (psi[0] * i[1] - psi[1] * i[0]);
    result[0] = (2.0 * v[0] - v[1] - v[2]) / 3.0 - p->r_s * ab[0];
    result[1] = (v[1] - v[2]) / SQRT_3 - p->r_s * ab[1];
    result[2] = y[3];
    result[3] = p->inertia > 0.0 ? p->pole_pairs / p->inertia * (torque - p->load_nm) : 0.0;
}

static void advance(const plant *p, double y[4], const double leg[3], double i[2])
{
    const double h = p->period / SUBSTEPS;
    for (int n = 0; n < SUBSTEPS; n++) {
        double k[4][4], at[4];
        slope(p, y, leg, i, k[0]);
        for (int stage = 1; stage < 4; stage++) {
            for (int m = 0; m < 4; m++)
                at[m] = y[m] + (stage == 3 ? h : 0.5 * h) * k[stage - 1][m];
            slope(p, at, leg, i, k[stage]);
        }
        for (int m = 0; m < 4; m++)
            y[m] += h / 6.0 * (k[0][m] + 2.0 * k[1][m] + 2.0 * k[2][m] + k[3][m]);
    }
}

/* Uniform noise with a standard deviation of one, always the same. */
static double noise(uint32_t *seed)
{
    *seed = *seed * 1664525u + 1013904223u;
    return ((double)(*seed >> 8) / 8388608.0 - 1.0) * SQRT_3;
}

/* One leg's command for each phase: symmetric modulation, within the bus. */
static void legs_of(const double v_ab[2], double v_dc, double leg[3])
{
    phases_of(v_ab, leg);
    const double top = fmax(leg[0], fmax(leg[1], leg[2])), low = fmin(leg[0], fmin(leg[1], leg[2]));
    for (int k = 0; k < 3; k++)
        leg[k] = fmax(-0.5 * v_dc, fmin(0.5 * v_dc, leg[k] - 0.5 * (top + low)));
}

/* Rows of `command`: torque, speed, i_d, i_q, v_dc, whether the torque (1) or the currents (0) are commanded. */
void simulate(const plant *given, int count, const double (*command)[6], double (*out)[COLUMNS])
{
    plant now = *given;
    const plant *p = &now;
    motor_current_control control;
    double psi[2], l[3], i[2] = {0.0, 0.0}, y[4], leg[3] = {0.0, 0.0, 0.0}, next_leg[3];
    uint32_t seed = 1u;
    motor_current_control_init(&control);
    plant_flux(p, 0.0, 0.0, psi, l);
    y[0] = psi[0];
    y[1] = psi[1];
    y[2] = 0.0;
    y[3] = command[0][1];
    for (int n = 0; n < count; n++) {
        double ab[2], abc[3], dq[2], v_ab[2], v[2];
        float read[2], i_dq[2], i_ref[2], v_ref[2], bias[2] = {0.0f, 0.0f};
        now.v_dc = command[n][4];
        if (!(p->inertia > 0.0))
            y[3] = command[n][1];
        turn(y, -y[2], psi);
        current_of(p, psi, i);
        turn(i, y[2], ab);
        phases_of(ab, abc);
        const float omega = (float)y[3], v_dc = (float)p->v_dc, r_s = motor_r_s_ohm((float)p->winding_c);
        const double believed = y[2] - p->angle_error;
        const double a = p->gain_a * abc[0] + p->offset_a + p->noise_a * noise(&seed);
        const double b = p->gain_b * abc[1] + p->offset_b + p->noise_a * noise(&seed);
        read[0] = (float)a;
        read[1] = (float)((a + 2.0 * b) / SQRT_3);
        if (p->is_compensated > 0.0)
            motor_corrected_current_a(read, read);
        dq[0] = read[0];
        dq[1] = read[1];
        turn(dq, -(double)motor_angle_rad((float)believed, omega), dq);
        i_dq[0] = (float)dq[0];
        i_dq[1] = (float)dq[1];
        int report = MOTOR_OK;
        i_ref[0] = (float)command[n][2];
        i_ref[1] = (float)command[n][3];
        if (command[n][5] > 0.0)
            report = motor_current_reference_a((float)command[n][0], omega, v_dc, r_s, i_ref);
        const int control_report = motor_current_control_v(&control, i_ref, i_dq, omega, v_dc, r_s, v_ref);
        out[n][I_D] = i[0];
        out[n][I_Q] = i[1];
        out[n][TORQUE] = 1.5 * p->pole_pairs * (psi[0] * i[1] - psi[1] * i[0]);
        out[n][OMEGA] = y[3];
        out[n][V_D] = v_ref[0];
        out[n][V_Q] = v_ref[1];
        out[n][REF_D] = i_ref[0];
        out[n][REF_Q] = i_ref[1];
        out[n][REPORT] = control_report != MOTOR_OK ? control_report : report;
        out[n][PHASE_A] = abc[0];
        out[n][INJECTED] = p->injected_v * sin(p->injected_rad_per_sample * n);
        out[n][LENGTH_V] = hypot(v_ref[0], v_ref[1]);
        v[0] = v_ref[0];
        v[1] = v_ref[1];
        v[p->injected_axis > 0.0] += out[n][INJECTED];
        const double ahead = (double)motor_angle_ahead_rad((float)fmod(believed, 2.0 * 3.14159265358979323846), omega);
        turn(v, ahead, v_ab);
        if (p->is_compensated > 0.0) {
            motor_add_bias_v(bias);
            v_ab[0] += (double)bias[0];
            v_ab[1] += (double)bias[1];
        }
        legs_of(v_ab, p->v_dc, next_leg);
        if (p->is_compensated > 0.0) {
            dq[0] = i_ref[0];
            dq[1] = i_ref[1];
            turn(dq, ahead, ab);
            phases_of(ab, abc);
            for (int k = 0; k < 3; k++) {
                next_leg[k] += (double)motor_leg_voltage_v((float)abc[k], v_dc);
                next_leg[k] = fmax(-0.5 * p->v_dc, fmin(0.5 * p->v_dc, next_leg[k]));
            }
        }
        advance(p, y, leg, i);
        for (int k = 0; k < 3; k++)
            leg[k] = next_leg[k];
    }
}
