#include "fb_board.h"
#include "fb_line.h"

#include <string.h>

#if !FB_LINK_CAN

#define MOST_READ 32u

static struct {
    uint8_t octets[1u + FB_CODED_OCTETS(FB_BLOCK_HEADER_OCTETS + FB_SERIAL_BLOCK_OCTETS)];
    size_t size, gone;
    struct fb_coder coder;
    bool is_cut; /* the last frame went out in part: a zero ends it */
} out;

static struct {
    struct fb_decoder decoder;
    uint8_t octets[MOST_READ];
    size_t size, taken;
} in;

void fb_line_init(void)
{
    memset(&out, 0, sizeof(out));
    memset(&in, 0, sizeof(in));
    out.is_cut = true;
}

void fb_line_begin(uint16_t id)
{
    out.octets[0] = 0u;
    fb_coder_begin(&out.coder, &out.octets[1], id);
}

void fb_line_put(uint8_t octet)
{
    fb_coder_put(&out.coder, octet);
}

void fb_line_end(void)
{
    out.size = 1u + fb_coder_end(&out.coder);
    out.gone = out.is_cut ? 0u : 1u;
    out.is_cut = false;
}

void fb_line_drop(void)
{
    out.size = 0;
    out.gone = 0;
    out.is_cut = true;
}

bool fb_line_flush(void)
{
    if (out.gone < out.size) {
        out.gone += fb_board_send(&out.octets[out.gone], out.size - out.gone);
    }
    return out.gone >= out.size;
}

bool fb_line_receive(struct fb_frame *frame)
{
    bool is_complete = false;

    while (!is_complete) {
        if (in.taken >= in.size) {
            in.size = fb_board_receive(in.octets, MOST_READ);
            in.taken = 0;
            if (in.size == 0u) {
                break;
            }
        }
        is_complete = fb_decoder_take(&in.decoder, in.octets[in.taken], frame);
        in.taken++;
    }
    return is_complete;
}

#endif
