/* fluxbench in an ECU that has XCP: one variable that the host reads and writes, one call in the fast routine.

   In the PWM interrupt, right after the currents were sampled, in the place of the ECU's own current control:

       struct fluxbench_vector v;
       const bool gates = fluxbench_step(i_alpha, i_beta, v_dc, &v);

       ... v.x and v.y (alpha, beta) to the modulator, the gates as it says ...
       XcpEvent(...); the DAQ event that copies fluxbench.row

   Current vectors are amplitude-invariant, alpha lies on phase A. All words have 32 bits. */

#ifndef FLUXBENCH_XCP_H
#define FLUXBENCH_XCP_H

#include <stdbool.h>
#include <stdint.h>

#define FLUXBENCH_MAGIC 0x46425831u
#define FLUXBENCH_VERSION 1u

enum { FLUXBENCH_OFF = 0, FLUXBENCH_ON = 1, FLUXBENCH_FAULTED = 2 };
enum { FLUXBENCH_SETTLING = 0, FLUXBENCH_CAPTURING = 1, FLUXBENCH_HOLDING = 2 };
enum { FLUXBENCH_SWITCH_ON = 1, FLUXBENCH_SWITCH_OFF = 2, FLUXBENCH_RUN = 3, FLUXBENCH_CLEAR = 4 };
enum { FLUXBENCH_GATES_OFF = 0, FLUXBENCH_CONTROL = 1, FLUXBENCH_INJECTION = 2 };
enum { FLUXBENCH_OVERCURRENT = 1, FLUXBENCH_HEARTBEAT = 2, FLUXBENCH_BUS = 3, FLUXBENCH_TRIPPED = 4 };

struct fluxbench_vector {
    float x, y;
};

struct fluxbench_row {
    uint32_t tick;
    uint32_t status; /* state, phase << 2, refused << 4, fault << 8, number of the last order << 16 */
    struct fluxbench_vector i; /* alpha, beta, at this tick [A] */
    struct fluxbench_vector v; /* alpha, beta, commanded from it [V] */
    float v_dc;
};

struct fluxbench_program {
    float limit_current_a, limit_voltage_v; /* taken over when it is switched on */
    uint32_t mode;
    uint32_t ramp_ticks, freeze_ticks, settle_ticks, capture_ticks; /* from the order: reached, injecting; before, of rows */
    struct fluxbench_vector direction;                             /* of the d axis: cosine, sine */
    struct fluxbench_vector start, swept;                          /* set point, and what a trapezoid adds [A] */
    float feed_forward;                                            /* [V/A] */
    struct fluxbench_vector proportional, integral;                /* [V/A], and the same each tick */
    float amplitude_v;
    uint32_t wave_step, turn_step; /* each tick, in 2^-32 of a period */
    uint32_t sine;
};

/* The host finds it by its address, and knows it by its first two words. */
struct fluxbench {
    uint32_t magic, version;
    float sampling_hz, pwm_hz, max_current_a, max_voltage_v, dc_bus_v, delay_samples;
    uint32_t watchdog_ticks;
    struct fluxbench_row row;
    uint32_t beat;
    uint32_t order; /* a number << 16, and what to do: written last */
    struct fluxbench_program program;
};

extern volatile struct fluxbench fluxbench;

/* One sampling period; returns whether the gates are to be on. */
bool fluxbench_step(float i_alpha, float i_beta, float v_dc, struct fluxbench_vector *v);

/* The ECU's own protection has switched off: fluxbench stays off until the host clears it. */
void fluxbench_trip(void);

#endif
