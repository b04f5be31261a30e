#include "fb_board.h"
#include "fb_line.h"

#if FB_LINK_CAN

#include "fb_frame.h"

#define NODE_BITS 3u

static struct fb_frame out;
static bool is_waiting;

void fb_line_init(void)
{
    is_waiting = false;
}

void fb_line_begin(uint16_t id)
{
    out.id = (uint16_t)(id | FB_NODE);
    out.size = 0;
}

void fb_line_put(uint8_t octet)
{
    out.data[out.size] = octet;
    out.size++;
}

void fb_line_end(void)
{
    is_waiting = true;
}

void fb_line_drop(void)
{
    is_waiting = false;
}

bool fb_line_flush(void)
{
    if (is_waiting) {
        is_waiting = !fb_board_can_send(&out);
    }
    return !is_waiting;
}

/* Own node, and EStop of any. */
bool fb_line_receive(struct fb_frame *frame)
{
    while (fb_board_can_receive(frame)) {
        const uint16_t id = (uint16_t)(frame->id & ~NODE_BITS);

        if ((frame->id & NODE_BITS) == FB_NODE || id == FLUXBENCH_E_STOP_FRAME_ID) {
            frame->id = id;
            return true;
        }
    }
    return false;
}

#endif
