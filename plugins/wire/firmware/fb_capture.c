#include "fb_capture.h"

#include <string.h>

#include "fb_board.h"
#include "fb_frame.h"
#include "fb_registers.h"
#include "fluxbench_registers.h"

#define CHANNELS 8u

FB_CAPTURE_MEMORY static uint16_t memory[FB_CAPTURE_WORDS];

/* How the rows are laid out, and where the next one goes. Replaced while nothing is captured. */
static struct {
    uint32_t mask;
    bool f32;
    float per_unit[CHANNELS];
    uint32_t next; /* word of the ring */
} layout;

static struct fb_captured held;

void fb_capture_init(void)
{
    memset(&layout, 0, sizeof(layout));
    memset(&held, 0, sizeof(held));
    held.crc = FB_CRC_START;
}

static uint32_t words_of_row(uint32_t mask, bool f32)
{
    uint32_t words = 0;

    for (uint32_t bit = 0; bit < CHANNELS; bit++) {
        words += (mask >> bit) & 1u;
    }
    return f32 ? 2u * words : words;
}

static void set_scales(void)
{
    static const uint8_t scale_of[CHANNELS] = {
        FLUXBENCH_REG_CURRENT_SCALE_A, FLUXBENCH_REG_CURRENT_SCALE_A, FLUXBENCH_REG_VOLTAGE_SCALE_V,
        FLUXBENCH_REG_VOLTAGE_SCALE_V, FLUXBENCH_REG_BUS_SCALE_V,     FLUXBENCH_REG_CURRENT_SCALE_A,
        FLUXBENCH_REG_CURRENT_SCALE_A, FLUXBENCH_REG_CURRENT_SCALE_A,
    };

    for (uint32_t k = 0; k < CHANNELS; k++) {
        layout.per_unit[k] = 1.0f / fb_register(scale_of[k]);
    }
}

uint8_t fb_capture_allot(uint32_t rows)
{
    const uint32_t mask = fb_register_whole(FLUXBENCH_REG_CAPTURE_MASK);
    const bool f32 = fb_register_is_on(FLUXBENCH_REG_CAPTURE_FORMAT);
    const uint32_t row_octets = 2u * words_of_row(mask, f32);

    if ((mask & ~FB_CAPTURE_CHANNELS) != 0u) {
        return FLUXBENCH_ACK_NOT_SUPPORTED;
    }
    if ((uint64_t)rows * row_octets > FLUXBENCH_LONGEST_CAPTURE) {
        return FLUXBENCH_ACK_NO_MEMORY;
    }
    fb_board_lock(); /* holding: nobody captures, but the last row may be under way */
    layout.mask = mask;
    layout.f32 = f32;
    layout.next = 0;
    set_scales();
    held.number = (uint16_t)(held.number % FLUXBENCH_LAST_CAPTURE + 1u);
    held.rows = rows;
    held.done = 0;
    held.octets = 0;
    held.whole = rows * row_octets;
    held.crc = FB_CRC_START;
    held.start = 0;
    fb_board_unlock();
    fb_register_set(FLUXBENCH_REG_CAPTURE_NUMBER, (float)held.number);
    fb_register_set(FLUXBENCH_REG_CAPTURE_ROWS, (float)rows);
    fb_register_set(FLUXBENCH_REG_CAPTURE_ROW_BYTES, (float)row_octets);
    return FLUXBENCH_ACK_OK;
}

static void put(uint16_t word)
{
    memory[layout.next] = word;
    layout.next++;
    if (layout.next >= FB_CAPTURE_WORDS) {
        layout.next = 0;
    }
    held.crc = fb_crc(fb_crc(held.crc, (uint8_t)(word & 0xFFu)), (uint8_t)(word >> 8));
    held.octets += 2u;
}

static void put_value(float value, float per_unit)
{
    if (layout.f32) {
        uint32_t bits;

        memcpy(&bits, &value, sizeof(bits));
        put((uint16_t)(bits & 0xFFFFu));
        put((uint16_t)(bits >> 16));
    } else {
        put((uint16_t)fb_counts(value, per_unit));
    }
}

void fb_capture_take(const struct fb_row *row, uint32_t tick)
{
    const float values[CHANNELS] = {row->i_ab.x, row->i_ab.y, row->v_ab.x, row->v_ab.y,
                                    row->v_dc,   row->i_a,    row->i_b,    row->i_c};

    if (held.done == 0u) {
        held.start = tick;
    }
    for (uint32_t k = 0; k < CHANNELS; k++) {
        if (((layout.mask >> k) & 1u) != 0u) {
            put_value(values[k], layout.per_unit[k]);
        }
    }
    held.done++;
}

struct fb_captured fb_captured(void)
{
    struct fb_captured copy;

    fb_board_lock();
    copy = held;
    fb_board_unlock();
    return copy;
}

uint8_t fb_capture_octet(uint32_t offset)
{
    const uint16_t word = memory[(offset / 2u) % FB_CAPTURE_WORDS];

    return (uint8_t)((offset & 1u) != 0u ? word >> 8 : word & 0xFFu);
}

bool fb_capture_is_overwritten(uint32_t offset, uint32_t octets_so_far)
{
    const uint32_t kept = 2u * FB_CAPTURE_WORDS;

    return octets_so_far > kept && offset < octets_so_far - kept;
}
