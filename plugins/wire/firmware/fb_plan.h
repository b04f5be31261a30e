/* Programs as pieces: what an excitation in the registers comes to, sample by sample. Made in the main loop, run by
   fb_power. A piece has one linear set-point; the pieces of a trapezoid are laid out as they come. */

#ifndef FB_PLAN_H
#define FB_PLAN_H

#include <stdbool.h>
#include <stdint.h>

#include "fb_math.h"

#define FB_ENDLESS 0xFFFFFFFFu
#define FB_MOST_PIECES 6u

enum fb_mode { FB_OFF, FB_CONTROL, FB_OPEN };

struct fb_piece {
    enum fb_mode mode;
    uint32_t samples;
    struct fb_vector start; /* set-point at its first sample [A], believed frame */
    struct fb_vector slope; /* a sample */
    bool captured;
    bool averaged; /* the mean voltage over it becomes the base voltage */
    bool injecting;
};

/* Corners are at 0, 1, 3, 5, 7 and 8 eighths of a period. */
struct fb_trapezoid {
    uint32_t corners; /* edges to come; 0: no trapezoid */
    uint64_t eighth;  /* of a period, in 2^-32 samples */
    struct fb_vector origin, amplitude;
    float per_sample; /* of an eighth, the share of the amplitude */
};

struct fb_wave {
    float amplitude_v;
    bool square;
    uint64_t cycles;      /* of the wave a sample, in 2^-64 */
    uint64_t turns;       /* of its vector a sample, in 2^-64 */
    uint64_t delay;       /* of the acting voltage, in 2^-64 periods */
};

struct fb_plan {
    struct fb_piece pieces[FB_MOST_PIECES];
    uint8_t count;
    struct fb_trapezoid trapezoid; /* after the pieces */
    struct fb_wave wave;
    float per_averaged; /* 1 / samples of the averaged piece */
    bool off_after;
    uint32_t samples; /* all of it */
    uint32_t rows;    /* of its capture */
};

/* PI control with feed-forward, tuned from the nameplate. */
struct fb_tuning {
    struct fb_vector proportional, per_proportional, integral; /* the integral a sample */
    struct fb_vector inductance;                               /* over the sample time: V for A a sample */
    float resistance_ohm;
};

/* Nameplate: the host's, or the board's own where the host knows none. */
struct fb_nameplate {
    float resistance_ohm, l_d_h, l_q_h, rated_a;
};
struct fb_nameplate fb_nameplate(void);

struct fb_tuning fb_tuned(float bandwidth_hz, float damping);

/* The excitation in the registers, from the set-point `from` on; FLUXBENCH_ACK_OK, or why there is none. */
uint8_t fb_plan_program(struct fb_plan *plan, struct fb_vector from);

/* To zero current at the pace of the control. */
void fb_plan_to_zero(struct fb_plan *plan, struct fb_vector from);

/* `samples` of what is held. */
void fb_plan_still(struct fb_plan *plan, enum fb_mode mode, struct fb_vector at, uint32_t samples, bool captured);

/* The next edge of a trapezoid. In the sampling interrupt. */
void fb_plan_edge(struct fb_trapezoid *trapezoid, uint32_t edge, struct fb_piece *piece);

#endif
