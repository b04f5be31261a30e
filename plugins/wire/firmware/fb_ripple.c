#include "fb_ripple.h"

#include <string.h>

#include "fb_board.h"
#include "fb_frame.h"
#include "fb_registers.h"
#include "fluxbench_registers.h"

#define COUNTS 6u /* of a row: mean, ripple and v of d, then of q */
#define ROW_OCTETS (2u * COUNTS)
#define NEARLY 18446744074u /* 1e-9 of a period, in 2^-64 */
#define WIRE_SLACK 1.000001

FB_CAPTURE_MEMORY static int16_t memory[FB_RIPPLE_ROWS][COUNTS];

/* Sums over the samples of a row. */
struct axis {
    float i, gi, fv;
};

static struct {
    uint32_t rows; /* when it is complete; 0: off */
    uint32_t made;
    uint32_t crc;
    uint32_t periods;    /* of a row */
    uint64_t cycles;     /* a sample */
    uint64_t phase;      /* since the capture began */
    uint32_t in_row;     /* periods so far */
    struct fb_vector about; /* currents are counted from here, so that sums stay small */
    float n, g, gg, ff;
    struct axis d, q;
    float per_a, per_ripple_a, per_v;
} state;

void fb_ripple_init(void)
{
    memset(&state, 0, sizeof(state));
    state.crc = FB_CRC_START;
}

static void begin_row(void)
{
    const struct axis none = {0.0f, 0.0f, 0.0f};

    state.n = 0.0f;
    state.g = 0.0f;
    state.gg = 0.0f;
    state.ff = 0.0f;
    state.d = none;
    state.q = none;
    state.in_row = 0;
}

static uint8_t rows_of(const struct fb_plan *plan, uint32_t periods, uint32_t *rows)
{
    const double hz = (double)fb_register(FLUXBENCH_REG_FREQUENCY_HZ);
    const double many = (double)plan->rows * hz / (double)fb_facts.sampling_hz / (double)periods + 1e-9;
    uint8_t status = FLUXBENCH_ACK_OK;

    if (hz / (double)periods > (double)FB_RIPPLE_RATE_HZ * WIRE_SLACK) {
        status = FLUXBENCH_ACK_OUT_OF_RANGE;
    } else if (many >= (double)FB_RIPPLE_ROWS + 1.0) {
        status = FLUXBENCH_ACK_NO_MEMORY;
    } else {
        *rows = (uint32_t)many;
    }
    return status;
}

uint8_t fb_ripple_allot(const struct fb_plan *plan)
{
    const uint32_t periods = fb_register_whole(FLUXBENCH_REG_RIPPLE_PERIODS);
    uint32_t rows = 0;

    if (periods > 0u && plan->wave.amplitude_v > 0.0f) {
        const uint8_t status = rows_of(plan, periods, &rows);

        if (status != FLUXBENCH_ACK_OK) {
            return status;
        }
    }
    fb_board_lock();
    fb_ripple_init();
    state.rows = rows;
    state.periods = periods;
    state.cycles = plan->wave.cycles;
    state.phase = NEARLY;
    state.about.x = fb_register(FLUXBENCH_REG_CURRENT_D_A);
    state.about.y = fb_register(FLUXBENCH_REG_CURRENT_Q_A);
    state.per_a = 1.0f / fb_register(FLUXBENCH_REG_CURRENT_SCALE_A);
    state.per_ripple_a = 1.0f / fb_register(FLUXBENCH_REG_RIPPLE_SCALE_A);
    state.per_v = 1.0f / fb_register(FLUXBENCH_REG_VOLTAGE_SCALE_V);
    fb_board_unlock();
    fb_register_set(FLUXBENCH_REG_RIPPLE_ROWS, (float)rows);
    return FLUXBENCH_ACK_OK;
}

static void put(uint32_t column, int16_t counts)
{
    const uint16_t word = (uint16_t)counts;

    memory[state.made][column] = counts;
    state.crc = fb_crc(fb_crc(state.crc, (uint8_t)(word & 0xFFu)), (uint8_t)(word >> 8));
}

static void put_axis(const struct axis *axis, uint32_t column, float about, float per_determinant, float per_ff)
{
    const float ripple = (state.n * axis->gi - state.g * axis->i) * per_determinant;
    const float mean = (axis->i * state.gg - axis->gi * state.g) * per_determinant;

    put(column, fb_counts(about + mean, state.per_a));
    put(column + 1u, fb_counts(ripple, state.per_ripple_a));
    put(column + 2u, fb_counts(axis->fv * per_ff, state.per_v));
}

static void end_row(void)
{
    const float determinant = state.n * state.gg - state.g * state.g;
    const float per_determinant = determinant > 1e-9f ? fb_reciprocal(determinant) : 0.0f;
    const float per_ff = state.ff > 1e-9f ? fb_reciprocal(state.ff) : 0.0f;

    put_axis(&state.d, 0u, state.about.x, per_determinant, per_ff);
    put_axis(&state.q, 3u, state.about.y, per_determinant, per_ff);
    state.made++;
    begin_row();
}

static void add_axis(struct axis *axis, float i, float v, const struct fb_injected *injected)
{
    axis->i += i;
    axis->gi += injected->ripple * i;
    axis->fv += injected->wave * v;
}

void fb_ripple_take(struct fb_vector i, struct fb_vector v_over_base, const struct fb_injected *injected, bool is_last)
{
    const uint64_t before = state.phase;

    if (state.made >= state.rows) {
        return;
    }
    state.n += 1.0f;
    state.g += injected->ripple;
    state.gg += injected->ripple * injected->ripple;
    state.ff += injected->wave * injected->wave;
    add_axis(&state.d, i.x - state.about.x, v_over_base.x, injected);
    add_axis(&state.q, i.y - state.about.y, v_over_base.y, injected);
    state.phase += state.cycles;
    if (state.phase < before) { /* the next sample begins another period */
        state.in_row++;
    }
    if (state.in_row >= state.periods || is_last) {
        end_row();
    }
}

struct fb_ripple_made fb_ripple_made(void)
{
    struct fb_ripple_made made;

    fb_board_lock();
    made.rows = state.made;
    made.octets = ROW_OCTETS * state.made;
    made.whole = ROW_OCTETS * state.rows;
    made.crc = state.crc;
    fb_board_unlock();
    return made;
}

uint8_t fb_ripple_octet(uint32_t offset)
{
    const uint32_t column = (offset % ROW_OCTETS) / 2u;
    const uint16_t word = (uint16_t)memory[offset / ROW_OCTETS][column];

    return (uint8_t)((offset & 1u) != 0u ? word >> 8 : word & 0xFFu);
}

const int16_t *fb_ripple_counts(uint32_t row, uint32_t axis)
{
    return &memory[row][3u * axis];
}
