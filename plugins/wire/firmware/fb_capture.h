/* Memory for the rows of the latest program: a ring of 16-bit words with a CRC-32 that runs along. */

#ifndef FB_CAPTURE_H
#define FB_CAPTURE_H

#include <stdbool.h>
#include <stdint.h>

#include "fb_math.h"

/* All but the temperature; i_c only where it is measured or follows from the others, which it always does. */
#define FB_CAPTURE_CHANNELS 255u

/* What a row is made of. */
struct fb_row {
    struct fb_vector i_ab, v_ab;
    float v_dc, i_a, i_b, i_c;
};

struct fb_captured {
    uint16_t number;
    uint32_t rows;   /* when it is complete */
    uint32_t done;   /* samples so far */
    uint32_t octets; /* so far */
    uint32_t whole;  /* octets when it is complete */
    uint32_t crc;    /* of the octets so far */
    uint32_t start;  /* tick of row 0 */
};

void fb_capture_init(void);

/* Get ready for `rows` of the channels in the registers; FLUXBENCH_ACK_OK, or why not. */
uint8_t fb_capture_allot(uint32_t rows);

/* In the sampling interrupt. */
void fb_capture_take(const struct fb_row *row, uint32_t tick);

/* A consistent copy. */
struct fb_captured fb_captured(void);

/* What is in the memory at an octet of the capture, that has been captured and is not overwritten. */
uint8_t fb_capture_octet(uint32_t offset);
bool fb_capture_is_overwritten(uint32_t offset, uint32_t octets_so_far);

#endif
