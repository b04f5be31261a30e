#include "fb_frame.h"

#define OVERHEAD 6u /* identifier and CRC */
#define LONGEST_RUN 255u

uint32_t fb_crc(uint32_t crc, uint8_t octet)
{
    static const uint32_t of_nibble[16] = {
        0x00000000u, 0x1DB71064u, 0x3B6E20C8u, 0x26D930ACu, 0x76DC4190u, 0x6B6B51F4u, 0x4DB26158u, 0x5005713Cu,
        0xEDB88320u, 0xF00F9344u, 0xD6D6A3E8u, 0xCB61B38Cu, 0x9B64C2B0u, 0x86D3D2D4u, 0xA00AE278u, 0xBDBDF21Cu,
    };
    uint32_t value = crc ^ octet;

    value = of_nibble[value & 15u] ^ (value >> 4);
    value = of_nibble[value & 15u] ^ (value >> 4);
    return value;
}

uint32_t fb_crc_end(uint32_t crc)
{
    return crc ^ 0xFFFFFFFFu;
}

/* Out */

static void stuff(struct fb_coder *coder, uint8_t octet)
{
    if (octet != 0u) {
        coder->out[coder->size] = octet;
        coder->size++;
    }
    if (octet == 0u || coder->size - coder->code == LONGEST_RUN) {
        coder->out[coder->code] = (uint8_t)(coder->size - coder->code);
        coder->code = coder->size;
        coder->size++;
    }
}

void fb_coder_begin(struct fb_coder *coder, uint8_t *out, uint16_t id)
{
    coder->out = out;
    coder->code = 0;
    coder->size = 1;
    coder->crc = FB_CRC_START;
    fb_coder_put(coder, (uint8_t)(id & 0xFFu));
    fb_coder_put(coder, (uint8_t)(id >> 8));
}

void fb_coder_put(struct fb_coder *coder, uint8_t octet)
{
    coder->crc = fb_crc(coder->crc, octet);
    stuff(coder, octet);
}

size_t fb_coder_end(struct fb_coder *coder)
{
    const uint32_t crc = fb_crc_end(coder->crc);

    for (uint8_t shift = 0; shift < 32u; shift = (uint8_t)(shift + 8u)) {
        stuff(coder, (uint8_t)((crc >> shift) & 0xFFu));
    }
    coder->out[coder->code] = (uint8_t)(coder->size - coder->code);
    coder->out[coder->size] = 0u;
    return coder->size + 1u;
}

/* In */

/* Unstuffs in place; false for what no coder made. */
static bool unstuff(struct fb_decoder *decoder)
{
    uint8_t *octets = decoder->coded;
    size_t from = 0;
    size_t to = 0;

    while (from < decoder->size) {
        const size_t run = octets[from];

        if (run == 0u || run > decoder->size - from) {
            return false;
        }
        for (size_t k = 1; k < run; k++) {
            octets[to] = octets[from + k];
            to++;
        }
        from += run;
        if (run < LONGEST_RUN && from < decoder->size) {
            octets[to] = 0u;
            to++;
        }
    }
    decoder->size = to;
    return true;
}

static bool is_sound(const struct fb_decoder *decoder)
{
    const uint8_t *octets = decoder->coded;
    const size_t end = decoder->size - 4u;
    uint32_t crc = FB_CRC_START;
    uint32_t sent = 0;

    for (size_t k = 0; k < end; k++) {
        crc = fb_crc(crc, octets[k]);
    }
    for (size_t k = 0; k < 4u; k++) {
        sent |= (uint32_t)octets[end + k] << (8u * k);
    }
    return fb_crc_end(crc) == sent;
}

static bool complete(struct fb_decoder *decoder, struct fb_frame *frame)
{
    const uint8_t *octets = decoder->coded;

    if (!unstuff(decoder) || decoder->size < OVERHEAD || decoder->size > OVERHEAD + FB_FRAME_OCTETS ||
        !is_sound(decoder)) {
        return false;
    }
    frame->id = (uint16_t)(octets[0] | ((uint16_t)octets[1] << 8));
    frame->size = (uint8_t)(decoder->size - OVERHEAD);
    for (size_t k = 0; k < frame->size; k++) {
        frame->data[k] = octets[2u + k];
    }
    return true;
}

bool fb_decoder_take(struct fb_decoder *decoder, uint8_t octet, struct fb_frame *frame)
{
    bool is_complete = false;

    if (octet != 0u) {
        if (decoder->size < sizeof(decoder->coded) / sizeof(decoder->coded[0])) {
            decoder->coded[decoder->size] = octet;
            decoder->size++;
        } else {
            decoder->lost = true;
        }
    } else {
        is_complete = !decoder->lost && decoder->size > 0u && complete(decoder, frame);
        decoder->size = 0;
        decoder->lost = false;
    }
    return is_complete;
}
