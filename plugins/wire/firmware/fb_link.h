/* What comes and goes over the link, in order of urgency: answers and telemetry overtake the blocks of captures. */

#ifndef FB_LINK_H
#define FB_LINK_H

#include <stdbool.h>
#include <stdint.h>

#include "fb_frame.h"
#include "fb_line.h"

void fb_link_init(void);

/* A frame for this drive; false where none has come. */
bool fb_link_hear(struct fb_frame *frame);

/* Send a message of at most 8 octets; left out where too many are waiting (whoever misses it asks again). */
void fb_link_say(uint16_t id, const uint8_t *data, uint8_t size);

/* Hand over what the line takes now. */
void fb_link_pump(void);

#endif
