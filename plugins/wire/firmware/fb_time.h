/* The clock: microseconds since power-up as the board counts them, and milliseconds that wrap at 2^32. */

#ifndef FB_TIME_H
#define FB_TIME_H

#include <stdint.h>

void fb_time_init(void);
void fb_time_pass(void);   /* at least once in an hour */
uint32_t fb_time_us(void); /* since fb_time_init */
uint32_t fb_time_ms(void); /* as of the last fb_time_pass */

#endif
