/* Frames: an identifier and its octets; CRC-32 (IEEE 802.3) and COBS (doi:10.1109/90.769765) around them on a line.
   An octet has an element of its own in every array, also where a char has 16 bits. */

#ifndef FB_FRAME_H
#define FB_FRAME_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define FB_FRAME_OCTETS 64u /* of CAN FD; every message but a serial line's blocks */

struct fb_frame {
    uint16_t id;
    uint8_t size;
    uint8_t data[FB_FRAME_OCTETS];
};

#define FB_CRC_START 0xFFFFFFFFu
uint32_t fb_crc(uint32_t crc, uint8_t octet);
uint32_t fb_crc_end(uint32_t crc);

/* Writes a coded frame octet by octet: begin, put all, end. */
struct fb_coder {
    uint8_t *out;
    size_t size;
    size_t code; /* where the length of the present run goes */
    uint32_t crc;
};
void fb_coder_begin(struct fb_coder *coder, uint8_t *out, uint16_t id);
void fb_coder_put(struct fb_coder *coder, uint8_t octet);
size_t fb_coder_end(struct fb_coder *coder); /* octets in `out`, the closing zero included */

/* The longest that `payload` octets get. */
#define FB_CODED_OCTETS(payload) ((payload) + 6u + ((payload) + 6u) / 254u + 2u)

/* Takes octets from a line; true when one completes a sound frame, which is in `frame`. */
struct fb_decoder {
    uint8_t coded[FB_CODED_OCTETS(FB_FRAME_OCTETS)];
    size_t size;
    bool lost; /* too long: nothing is taken until the next zero */
};
bool fb_decoder_take(struct fb_decoder *decoder, uint8_t octet, struct fb_frame *frame);

#endif
