#include "fb_telemetry.h"

#include <stdbool.h>
#include <string.h>

#include "fb_board.h"
#include "fb_capture.h"
#include "fb_link.h"
#include "fb_power.h"
#include "fb_registers.h"
#include "fb_ripple.h"
#include "fb_session.h"
#include "fb_time.h"
#include "fluxbench_registers.h"

#define OCTETS 8u
#define PROGRESS_US 100000u
#define TICK_US 1000000u
#define LIVE_US 2000u       /* a live row: 500 a second */
#define MOST_LIVE 8u        /* that were saved up */
#define VOLTS_PER_COUNT 0.02f
#define NO_TEMPERATURE (-128)

static struct {
    uint8_t status_seq, measurement_seq, progress_seq;
    uint32_t status_us, progress_us, tick_us, live_us; /* when each was due last */
    uint8_t state, cause;
    uint16_t faults;
    uint8_t phase;
    uint16_t capture; /* as told */
    uint16_t live_capture;
    uint32_t live_row;
} told;

void fb_telemetry_init(void)
{
    memset(&told, 0, sizeof(told));
}

/* Whether a period is over; what was missed is not made up for. */
static bool is_due(uint32_t *last_us, uint32_t period_us)
{
    const uint32_t passed_us = fb_time_us() - *last_us;
    const bool due = passed_us >= period_us;

    if (due) {
        *last_us += passed_us < 2u * period_us ? period_us : passed_us;
    }
    return due;
}

static uint16_t volts(float v)
{
    const float counts = v / VOLTS_PER_COUNT;

    return counts > 0.0f ? (uint16_t)(counts < 65535.0f ? counts + 0.5f : 65535.0f) : (uint16_t)0u;
}

static int8_t celsius(void)
{
    const float measured = fb_register(FLUXBENCH_REG_TEMPERATURE_C);
    int8_t shown = NO_TEMPERATURE;

    if (fb_facts.has_thermometer) {
        shown = (int8_t)(measured > 127.0f ? 127.0f : (measured < -127.0f ? -127.0f : measured));
    }
    return shown;
}

static void say_status(const struct fb_news *news, uint8_t last_beat)
{
    const struct fluxbench_status_t status = {
        news->state, news->cause, last_beat, news->faults, volts(news->v_dc), celsius(), told.status_seq};
    uint8_t data[OCTETS] = {0u};

    (void)fluxbench_status_pack(data, &status, OCTETS);
    fb_link_say(FLUXBENCH_STATUS_FRAME_ID, data, FLUXBENCH_STATUS_LENGTH);
    told.status_seq = (uint8_t)((told.status_seq + 1u) & 0xFFu);
    told.state = news->state;
    told.cause = news->cause;
    told.faults = news->faults;
}

static void say_measurement(const struct fb_news *news)
{
    const float per_a = 1.0f / fb_register(FLUXBENCH_REG_CURRENT_SCALE_A);
    const struct fluxbench_measurement_t measurement = {
        told.measurement_seq, fb_counts(news->shown.x, per_a), fb_counts(news->shown.y, per_a), volts(news->v_dc),
        news->open_interlocks};
    uint8_t data[OCTETS] = {0u};

    (void)fluxbench_measurement_pack(data, &measurement, OCTETS);
    fb_link_say(FLUXBENCH_MEASUREMENT_FRAME_ID, data, FLUXBENCH_MEASUREMENT_LENGTH);
    told.measurement_seq = (uint8_t)((told.measurement_seq + 1u) & 0xFFu);
}

static void say_progress(const struct fb_news *news, const struct fb_captured *captured)
{
    const struct fluxbench_progress_t progress = {told.progress_seq, news->phase, captured->number, captured->done};
    uint8_t data[OCTETS] = {0u};

    (void)fluxbench_progress_pack(data, &progress, OCTETS);
    fb_link_say(FLUXBENCH_PROGRESS_FRAME_ID, data, FLUXBENCH_PROGRESS_LENGTH);
    told.progress_seq = (uint8_t)((told.progress_seq + 1u) & 0xFFu);
    told.phase = news->phase;
    told.capture = captured->number;
}

void fb_telemetry_say_tick(void)
{
    const struct fb_news news = fb_power_news();
    const struct fluxbench_tick_t tick = {news.tick, fb_time_us()};
    uint8_t data[OCTETS] = {0u};

    (void)fluxbench_tick_pack(data, &tick, OCTETS);
    fb_link_say(FLUXBENCH_TICK_FRAME_ID, data, FLUXBENCH_TICK_LENGTH);
}

static void say_axis(uint16_t id, uint32_t row, uint32_t axis)
{
    const int16_t *counts = fb_ripple_counts(row, axis);
    const struct fluxbench_ripple_d_t message = {(uint16_t)(row & 0xFFFFu), counts[0], counts[1], counts[2]};
    uint8_t data[OCTETS] = {0u};

    (void)fluxbench_ripple_d_pack(data, &message, OCTETS); /* of q in the same layout */
    fb_link_say(id, data, FLUXBENCH_RIPPLE_D_LENGTH);
}

/* As many live rows as the bus has room for; they are for eyes, and can all be read afterwards. */
static void say_live(uint16_t capture)
{
    const uint32_t made = fb_ripple_made().rows;
    uint32_t earned = (fb_time_us() - told.live_us) / LIVE_US;

    if (capture != told.live_capture) {
        told.live_capture = capture;
        told.live_row = 0;
    }
    if (earned > MOST_LIVE) {
        told.live_us = fb_time_us() - MOST_LIVE * LIVE_US;
        earned = MOST_LIVE;
    }
    while (earned > 0u && told.live_row < made) {
        say_axis(FLUXBENCH_RIPPLE_D_FRAME_ID, told.live_row, 0u);
        say_axis(FLUXBENCH_RIPPLE_Q_FRAME_ID, told.live_row, 1u);
        told.live_row++;
        told.live_us += LIVE_US;
        earned--;
    }
}

void fb_telemetry_say(void)
{
    /* The state first: a program that ends in between has all its rows by then. */
    const struct fb_news news = fb_power_news();
    const struct fb_captured captured = fb_captured();
    const uint32_t period_us = (uint32_t)(1e6f * fb_register(FLUXBENCH_REG_TELEMETRY_PERIOD_S));
    const bool has_changed = news.state != told.state || news.cause != told.cause || news.faults != told.faults;
    const bool due = is_due(&told.status_us, period_us);

    if (has_changed || due) {
        say_status(&news, fb_beat_last());
    }
    if (due) {
        say_measurement(&news);
    }
    if (is_due(&told.tick_us, TICK_US)) {
        fb_telemetry_say_tick();
    }
    if (news.phase != told.phase || captured.number != told.capture ||
        (news.state == FLUXBENCH_STATE_RUNNING && is_due(&told.progress_us, PROGRESS_US))) {
        say_progress(&news, &captured);
    }
    if (fb_register_is_on(FLUXBENCH_REG_RIPPLE_LIVE)) {
        say_live(captured.number);
    }
}
