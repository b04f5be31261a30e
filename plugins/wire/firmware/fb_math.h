/* Vectors, sines and reciprocals without a division or a library: what the sampling interrupt computes with. */

#ifndef FB_MATH_H
#define FB_MATH_H

#include <stdint.h>

/* (alpha, beta) in the stator frame, (d, q) in the believed one; also a direction (cos, sin). */
struct fb_vector {
    float x, y;
};

/* A sum that keeps what single precision would drop (Kahan, doi:10.1145/363707.363723). */
struct fb_sum {
    float total, rest;
};

float fb_rsqrt(float x);      /* 1 / sqrt(x), x > 0, to single precision */
float fb_reciprocal(float x); /* 1 / x, x > 0 */

/* A turn is 2^32 counts. */
struct fb_vector fb_direction(uint32_t turn);
uint32_t fb_turn_of(float radians);

struct fb_vector fb_turned(struct fb_vector v, struct fb_vector by);
struct fb_vector fb_turned_back(struct fb_vector v, struct fb_vector by);
float fb_square(struct fb_vector v);
float fb_length(struct fb_vector v);

void fb_add(struct fb_sum *sum, float value);

/* Rounded and saturated, as a converter does. */
int16_t fb_counts(float value, float counts_per_unit);

/* The fraction of `periods` (not negative) in counts of 2^-64 of a period. */
uint64_t fb_phase(double periods);

#endif
