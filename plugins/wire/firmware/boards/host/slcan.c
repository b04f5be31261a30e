/* A CAN bus without one: classic frames as a serial CAN adapter writes them (Lawicel's protocol, python-can's `slcan`),
   "t", three digits of the identifier, the length, the data, a carriage return. Built with FB_LINK_CAN. */

#include "fb_board.h"
#include "fb_config.h"
#include "fb_frame.h"
#include "terminal.h"

#if FB_LINK_CAN

#define HEAD 5u /* letters before the data */
#define LONGEST (HEAD + 16u + 1u)
#define MOST_DATA 8u

static uint8_t came[LONGEST], out[LONGEST];
static size_t came_size, out_size;

static uint8_t value_of(uint8_t letter)
{
    if (letter >= '0' && letter <= '9') {
        return (uint8_t)(letter - '0');
    }
    return (uint8_t)((letter | 0x20u) - 'a' + 10);
}

static uint8_t letter_of(uint8_t value)
{
    return (uint8_t)"0123456789ABCDEF"[value & 15u];
}

/* Whether what came is a frame; the adapter's other commands (bit rate, open, close) mean nothing here. */
static bool is_frame(struct fb_frame *frame)
{
    const size_t size = came_size >= HEAD ? value_of(came[4]) : 0u;

    if (came_size < HEAD || came[0] != 't' || size > MOST_DATA || came_size != HEAD + 2u * size) {
        return false;
    }
    frame->id = (uint16_t)((uint32_t)value_of(came[1]) << 8 | (uint32_t)value_of(came[2]) << 4 | value_of(came[3]));
    frame->size = (uint8_t)size;
    for (size_t k = 0u; k < size; k++) {
        frame->data[k] = (uint8_t)((uint32_t)value_of(came[HEAD + 2u * k]) << 4 | value_of(came[HEAD + 2u * k + 1u]));
    }
    return true;
}

bool fb_board_can_receive(struct fb_frame *frame)
{
    uint8_t letter;

    while (terminal_receive(&letter, 1u) == 1u) {
        if (letter == '\r') {
            const bool found = is_frame(frame);

            came_size = 0u;
            if (found) {
                return true;
            }
        } else if (came_size < LONGEST) {
            came[came_size] = letter;
            came_size++;
        }
    }
    return false;
}

static bool is_gone(void)
{
    const size_t taken = terminal_send(out, out_size);

    out_size -= taken;
    for (size_t k = 0u; k < out_size; k++) {
        out[k] = out[taken + k];
    }
    return out_size == 0u;
}

bool fb_board_can_send(const struct fb_frame *frame)
{
    if (out_size > 0u && !is_gone()) {
        return false;
    }
    out[0] = 't';
    out[1] = letter_of((uint8_t)(frame->id >> 8));
    out[2] = letter_of((uint8_t)(frame->id >> 4));
    out[3] = letter_of((uint8_t)frame->id);
    out[4] = letter_of(frame->size);
    for (size_t k = 0u; k < frame->size; k++) {
        out[HEAD + 2u * k] = letter_of((uint8_t)(frame->data[k] >> 4));
        out[HEAD + 2u * k + 1u] = letter_of(frame->data[k]);
    }
    out_size = HEAD + 2u * frame->size;
    out[out_size] = '\r';
    out_size++;
    (void)is_gone();
    return true;
}

#endif
