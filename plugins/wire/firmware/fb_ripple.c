#include "fb_ripple.h"

#include <string.h>

#include "fb_board.h"
#include "fb_frame.h"
#include "fb_registers.h"
#include "fluxbench_registers.h"

#define MOST_COUNTS 8u  /* of a row: mean, ripple, v and curvature of d, then of q */
#define NEARLY 18446744074u /* 1e-9 of a period, in 2^-64 */
#define WIRE_SLACK 1.000001
#define LEAST_SHAPE 0.01f /* mean square of what g^2 has beside 1 and g, from which on a row has a curvature */
#define MEAN_SQUARE_TRIANGLE 0.33333333f
#define MEAN_SQUARE_COSINE 0.5f

FB_CAPTURE_MEMORY static int16_t memory[FB_RIPPLE_ROWS * MOST_COUNTS];

/* Sums over the samples of a row. */
struct axis {
    float i, gi, ggi, fv;
};

struct sums {
    float n, g, gg, ggg, gggg, ff;
    struct axis axes[2];
};

static struct {
    uint32_t rows; /* when it is complete; 0: off */
    uint32_t made;
    uint32_t crc;        /* of the rows made */
    uint32_t crc_so_far; /* with what is there of the next one */
    uint32_t counts;     /* of a row */
    uint32_t periods;    /* of a row */
    uint64_t cycles;     /* a sample */
    uint64_t phase;      /* since the capture began */
    uint32_t in_row;     /* periods so far */
    struct fb_vector about; /* currents are counted from here, so that sums stay small */
    float mean_square;      /* of the unit ripple over a period */
    struct sums sums;
    struct sums ended;  /* of the row that ended last */
    uint32_t axes_left; /* of that row */
    float per_a, per_ripple_a, per_v;
} state;

void fb_ripple_init(void)
{
    memset(&state, 0, sizeof(state));
    state.crc = FB_CRC_START;
    state.crc_so_far = FB_CRC_START;
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
    state.counts = fb_register_is_on(FLUXBENCH_REG_RIPPLE_CURVATURE) ? MOST_COUNTS : MOST_COUNTS - 2u;
    state.periods = periods;
    state.mean_square = plan->wave.square ? MEAN_SQUARE_TRIANGLE : MEAN_SQUARE_COSINE;
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

static void put(uint32_t index, int16_t counts)
{
    const uint16_t word = (uint16_t)counts;

    memory[index] = counts;
    state.crc_so_far = fb_crc(fb_crc(state.crc_so_far, (uint8_t)(word & 0xFFu)), (uint8_t)(word >> 8));
}

static float per(float divisor)
{
    return divisor > 1e-9f ? fb_reciprocal(divisor) : 0.0f;
}

/* One after the other, each made orthogonal to those before: 1, g, g^2. */
static void put_axis(const struct sums *s, uint32_t axis, float about)
{
    const struct axis *a = &s->axes[axis];
    const bool is_curved = state.counts == MOST_COUNTS;
    const uint32_t index = state.made * state.counts + (axis > 0u ? state.counts / 2u : 0u);
    const float per_n = per(s->n);
    const float mean_g = s->g * per_n;
    const float of_i = a->gi - mean_g * a->i;
    const float per_of_g = per(s->gg - mean_g * s->g);
    float ripple = of_i * per_of_g;
    float curvature = 0.0f;
    float bent = 0.0f;

    if (is_curved) {
        const float mean_gg = s->gg * per_n;
        const float of_g = s->ggg - mean_gg * s->g;
        const float shared = of_g * per_of_g;
        const float of_gg = s->gggg - mean_gg * s->gg - shared * of_g;

        if (of_gg >= LEAST_SHAPE * s->n) {
            curvature = (a->ggi - mean_gg * a->i - shared * of_i) * per(of_gg);
        }
        ripple -= shared * curvature;
        bent = (state.mean_square - mean_gg) * curvature;
    }
    put(index, fb_counts(about + a->i * per_n - ripple * mean_g + bent, state.per_a));
    put(index + 1u, fb_counts(ripple, state.per_ripple_a));
    put(index + 2u, fb_counts(a->fv * per(s->ff), state.per_v));
    if (is_curved) {
        put(index + 3u, fb_counts(curvature, state.per_ripple_a));
    }
}

void fb_ripple_settle(void)
{
    if (state.axes_left == 2u) {
        put_axis(&state.ended, 0u, state.about.x);
        state.axes_left = 1u;
    } else if (state.axes_left == 1u) {
        put_axis(&state.ended, 1u, state.about.y);
        state.axes_left = 0u;
        state.crc = state.crc_so_far;
        state.made++;
    } else {
        /* nothing is left to do */
    }
}

static void end_row(void)
{
    fb_ripple_settle(); /* nothing, but for rows of one sample or two */
    fb_ripple_settle();
    state.ended = state.sums;
    state.axes_left = 2u;
    memset(&state.sums, 0, sizeof(state.sums));
    state.in_row = 0;
}

static void add_axis(struct axis *axis, float i, float v, const struct fb_injected *injected, float square)
{
    axis->i += i;
    axis->gi += injected->ripple * i;
    axis->ggi += square * i;
    axis->fv += injected->wave * v;
}

void fb_ripple_take(struct fb_vector i, struct fb_vector v_over_base, const struct fb_injected *injected, bool is_last)
{
    const uint64_t before = state.phase;
    const float square = injected->ripple * injected->ripple;
    struct sums *s = &state.sums;

    if (state.made + (state.axes_left > 0u ? 1u : 0u) >= state.rows) {
        return;
    }
    s->n += 1.0f;
    s->g += injected->ripple;
    s->gg += square;
    s->ggg += square * injected->ripple;
    s->gggg += square * square;
    s->ff += injected->wave * injected->wave;
    add_axis(&s->axes[0], i.x - state.about.x, v_over_base.x, injected, square);
    add_axis(&s->axes[1], i.y - state.about.y, v_over_base.y, injected, square);
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
    made.octets = 2u * state.counts * state.made;
    made.whole = 2u * state.counts * state.rows;
    made.crc = state.crc;
    fb_board_unlock();
    return made;
}

uint8_t fb_ripple_octet(uint32_t offset)
{
    const uint16_t word = (uint16_t)memory[offset / 2u];

    return (uint8_t)((offset & 1u) != 0u ? word >> 8 : word & 0xFFu);
}

const int16_t *fb_ripple_counts(uint32_t row, uint32_t axis)
{
    return &memory[row * state.counts + (axis > 0u ? state.counts / 2u : 0u)];
}
