/* Current control and injection, one sample at a time. In the sampling interrupt: no division, no library. */

#ifndef FB_CONTROL_H
#define FB_CONTROL_H

#include "fb_math.h"
#include "fb_plan.h"

/* What the loop remembers from sample to sample, in the believed frame. */
struct fb_loop {
    struct fb_vector set_point; /* of the next sample [A] */
    struct fb_vector integral;  /* [V] */
    struct fb_vector base;      /* frozen voltage of an injection [V] */
    struct fb_sum mean_d, mean_q;
    uint64_t wave, turn; /* phases, in 2^-64 */
};

/* What the injection does in this sample. */
struct fb_injected {
    struct fb_vector volts; /* on top of the base voltage */
    float wave, ripple;     /* unit wave, and unit ripple of the voltage that acts */
};

/* Vectors longer than `most_v` are shortened; the integrals follow (back-calculation). */
struct fb_vector fb_control(struct fb_loop *loop, const struct fb_tuning *tuning, const struct fb_piece *piece,
                            uint32_t k, struct fb_vector i, float most_v);

void fb_start_injection(struct fb_loop *loop);
struct fb_injected fb_inject(struct fb_loop *loop, const struct fb_wave *wave);

struct fb_vector fb_limited(struct fb_vector v, float most);

#endif
