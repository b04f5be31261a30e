/* Ripple demodulated on the drive: least squares over some injection periods, as the samples come.

       i(k) = mean + ripple g(k) + curvature (g(k)^2 - s)        v(k) - base = v f(k)        on each axis of the
       believed frame; s is the mean of g^2 over a period, and the curvature is left out where none is asked for */

#ifndef FB_RIPPLE_H
#define FB_RIPPLE_H

#include <stdbool.h>
#include <stdint.h>

#include "fb_control.h"
#include "fb_math.h"
#include "fb_plan.h"

#define FB_RIPPLE_RATE_HZ 500.0f

struct fb_ripple_made {
    uint32_t rows;   /* so far */
    uint32_t octets; /* so far */
    uint32_t whole;  /* octets when it is complete; 0: nothing is demodulated */
    uint32_t crc;    /* of the octets so far */
};

void fb_ripple_init(void);

/* Get ready for a program; FLUXBENCH_ACK_OK, or why not. */
uint8_t fb_ripple_allot(const struct fb_plan *plan);

/* In the sampling interrupt, once a sample: what is left to do of the row that ended last, an axis at a time. */
void fb_ripple_settle(void);

/* In the sampling interrupt, after that; `is_last` closes the last row. */
void fb_ripple_take(struct fb_vector i, struct fb_vector v_over_base, const struct fb_injected *injected, bool is_last);

struct fb_ripple_made fb_ripple_made(void);
uint8_t fb_ripple_octet(uint32_t offset);

/* Counts of a row that is made: mean, ripple, v (and curvature) of an axis (0: d, 1: q). */
const int16_t *fb_ripple_counts(uint32_t row, uint32_t axis);

#endif
