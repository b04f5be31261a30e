/* Answers to ReadBlock: blocks of a capture, of its ripple rows, or of the description, and an end. */

#ifndef FB_UPLOAD_H
#define FB_UPLOAD_H

#include <stdbool.h>
#include <stdint.h>

#include "fluxbench.h"

void fb_upload_init(void);

/* Take a request up; FLUXBENCH_ACK_OK, or why not. */
uint8_t fb_upload_ask(const struct fluxbench_read_block_t *request);

/* Put the next frame on the line, which is free; false where nothing is asked for. */
bool fb_upload_put_next(void);

#endif
