/* What the drive says of itself unasked, each message at its own pace. */

#ifndef FB_TELEMETRY_H
#define FB_TELEMETRY_H

void fb_telemetry_init(void);
void fb_telemetry_say(void);      /* what is due */
void fb_telemetry_say_tick(void); /* the clock, now */

#endif
