/* Ripple demodulated on the drive: least squares of mean and ripple over some injection periods, as the samples come.

       i(k) = mean + ripple g(k)        v(k) - base = v f(k)        on each axis of the believed frame */

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

/* In the sampling interrupt; `is_last` closes the last row. */
void fb_ripple_take(struct fb_vector i, struct fb_vector v_over_base, const struct fb_injected *injected, bool is_last);

struct fb_ripple_made fb_ripple_made(void);
uint8_t fb_ripple_octet(uint32_t offset);

/* Three counts of a row that is made: mean, ripple and v of an axis (0: d, 1: q). */
const int16_t *fb_ripple_counts(uint32_t row, uint32_t axis);

#endif
