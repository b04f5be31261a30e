/* One frame at a time on its way out, and frames in: a serial line, or a CAN bus (FB_LINK_CAN in fb_config.h). */

#ifndef FB_LINE_H
#define FB_LINE_H

#include <stdbool.h>
#include <stdint.h>

#include "fb_config.h"
#include "fb_frame.h"
#include "fluxbench.h"

#if FB_LINK_CAN && !FB_LINK_CAN_FD
#define FB_BLOCK_ID FLUXBENCH_BULK_FRAME_ID
#define FB_BLOCK_OCTETS 6u
#define FB_BLOCK_HEADER_OCTETS 2u
#define FB_MOST_BLOCKS 1024u /* of one answer; their number in the answer is in the frame, not their offset */
#else
#define FB_BLOCK_ID FLUXBENCH_BULK_FD_FRAME_ID
#define FB_BLOCK_HEADER_OCTETS 4u
#define FB_MOST_BLOCKS 65535u
#if FB_LINK_CAN
#define FB_BLOCK_OCTETS 60u
#else
#define FB_BLOCK_OCTETS FB_SERIAL_BLOCK_OCTETS
#endif
#endif

#if FB_LINK_CAN
#define FB_BLOCK_REGISTER 60.0f /* on a serial line only it says something */
#else
#define FB_BLOCK_REGISTER ((float)FB_SERIAL_BLOCK_OCTETS)
#endif

void fb_line_init(void);

/* Make a frame; only where fb_line_flush() has said that the last one is gone. */
void fb_line_begin(uint16_t id);
void fb_line_put(uint8_t octet);
void fb_line_end(void);
void fb_line_drop(void);  /* forget what was made */
bool fb_line_flush(void); /* hand over what is taken now; whether all is gone */

/* A frame for this drive; false where none has come. */
bool fb_line_receive(struct fb_frame *frame);

#endif
