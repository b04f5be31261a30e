/* The firmware under libFuzzer: what a host, a line, sensors and time may do to it, in any order. An input is a list of
   deeds; after each, what must always hold is asked. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fb_board.h"
#include "fb_frame.h"
#include "fb_power.h"
#include "fb_session.h"
#include "fluxbench.h"
#include "fluxbench_registers.h"

#define LINE 8192u

const struct fb_facts fb_facts = {
    .sampling_hz = 10000.0f,
    .pwm_hz = 10000.0f,
    .dc_bus_v = 400.0f,
    .voltage_delay_samples = 1.0f,
    .max_current_a = 6.0f,
    .max_voltage_v = 230.0f,
    .sensor_span_a = 15.9f,
    .trip_ratio = 1.2f,
    .overload_s = 2.0f,
    .watchdog_s = 0.2f,
    .longest_program_s = 60.0f,
    .hottest_c = 120.0f,
    .has_third_sensor = true,
    .has_thermometer = true,
    .has_brake = true,
    .has_interlocks = true,
    .resistance_ohm = 4.25f,
    .l_d_h = 0.04325f,
    .l_q_h = 0.06905f,
    .rated_a = 2.35f,
    .description = "name: fuzzed\nmotor: none",
};

static uint32_t now_us;
static struct fb_reading reading;
static float celsius;
static bool gates, gate_fault, is_locked;
static uint8_t interlocks;
static uint8_t line[LINE];
static size_t line_size, line_read;
static size_t taken_each;
static struct fb_decoder decoder;

static void require(bool held)
{
    if (!held) {
        abort();
    }
}

/* The board */

uint32_t fb_board_time_us(void) { return now_us; }
void fb_board_lock(void) { require(!is_locked); is_locked = true; }
void fb_board_unlock(void) { require(is_locked); is_locked = false; }
void fb_board_read(struct fb_reading *to) { *to = reading; }
bool fb_board_gate_fault(void) { return gate_fault; }
float fb_board_temperature_c(void) { return celsius; }
void fb_board_brake(bool engaged) { (void)engaged; }
uint8_t fb_board_interlocks(void) { return interlocks; }
void fb_board_gates(bool on) { gates = on; }

void fb_board_duties(float a, float b, float c)
{
    const float duties[] = {a, b, c};

    for (int k = 0; k < 3; k++) {
        require(gates && duties[k] >= -0.01f && duties[k] <= 1.01f); /* not with NaN either */
    }
}

size_t fb_board_receive(uint8_t *octets, size_t most)
{
    size_t count = 0;

    while (count < most && line_read < line_size) {
        octets[count++] = line[line_read++];
    }
    return count;
}

static bool is_the_drives(uint16_t id)
{
    return id >= FLUXBENCH_STATUS_FRAME_ID && id <= FLUXBENCH_BULK_FD_FRAME_ID;
}

size_t fb_board_send(const uint8_t *octets, size_t count)
{
    const size_t taken = count < taken_each ? count : taken_each;
    struct fb_frame frame;

    for (size_t k = 0; k < taken; k++) {
        if (fb_decoder_take(&decoder, octets[k], &frame)) {
            require(is_the_drives(frame.id));
        }
    }
    return taken;
}

/* Deeds */

struct input {
    const uint8_t *data;
    size_t size;
};

static uint8_t octet(struct input *input)
{
    if (input->size == 0u) {
        return 0u;
    }
    input->size--;
    return *input->data++;
}

static uint32_t word(struct input *input)
{
    uint32_t value = 0;

    for (int k = 0; k < 4; k++) {
        value = value << 8 | octet(input);
    }
    return value;
}

static float number(struct input *input)
{
    static const float usual[] = {0.0f, 1.0f, -1.0f, 2.0f, 3.0f, 0.1f, 0.01f, 25.0f, 4.0f, 100.0f, 500.0f, 15.0f, 1e30f, 0.001f};
    const uint8_t choice = octet(input);
    uint32_t bits;
    float value;

    if (choice < 2u * sizeof(usual) / sizeof(usual[0])) {
        return usual[choice / 2u];
    }
    bits = word(input);
    memcpy(&value, &bits, sizeof(value));
    return value;
}

static void hear(uint16_t id, const uint8_t *data, size_t size)
{
    uint8_t coded[FB_CODED_OCTETS(64)];
    struct fb_coder coder;

    fb_coder_begin(&coder, coded, id);
    for (size_t k = 0; k < size; k++) {
        fb_coder_put(&coder, data[k]);
    }
    size = fb_coder_end(&coder);
    if (line_size + size < LINE) {
        memcpy(&line[line_size], coded, size);
        line_size += size;
    }
}

static uint8_t seq;

static void command(uint8_t op, uint32_t arg)
{
    const struct fluxbench_command_t message = {op == FLUXBENCH_OP_IDENTIFY ? 77u : fb_session(), ++seq, op, arg};
    uint8_t data[8];

    (void)fluxbench_command_pack(data, &message, sizeof(data));
    hear(FLUXBENCH_COMMAND_FRAME_ID, data, sizeof(data));
}

static void write_register(uint8_t index, float value)
{
    const struct fluxbench_parameter_write_t message = {fb_session(), ++seq, index, value};
    uint8_t data[8];

    (void)fluxbench_parameter_write_pack(data, &message, sizeof(data));
    hear(FLUXBENCH_PARAMETER_WRITE_FRAME_ID, data, sizeof(data));
}

static void beat(void)
{
    static uint8_t beats;
    const struct fluxbench_heartbeat_t message = {fb_session(), ++beats, now_us / 1000u};
    uint8_t data[7];

    (void)fluxbench_heartbeat_pack(data, &message, sizeof(data));
    hear(FLUXBENCH_HEARTBEAT_FRAME_ID, data, sizeof(data));
}

static void require_sound(void)
{
    const struct fb_news news = fb_power_news();

    require(!is_locked);
    require(!gates || news.state != FLUXBENCH_STATE_DISARMED);
    require((news.faults == 0u) == (news.state != FLUXBENCH_STATE_FAULTED));
    require(interlocks == 0u || !fb_power_is_energised(news.state)); /* after a turn of the main loop */
    require(news.state <= FLUXBENCH_STATE_FAULTED && news.phase <= FLUXBENCH_PHASE_GIVEN_UP);
}

static void pass(uint32_t samples)
{
    uint32_t faulted = 0;

    for (uint32_t k = 0; k < samples; k++) {
        now_us += 100u;
        fb_sample();
        faulted = fb_power_news().state == FLUXBENCH_STATE_FAULTED && gates ? faulted + 1u : 0u;
        require(faulted <= 160u); /* 15 ms to the safe state */
    }
}

/* Armed, with a program that runs. */
static void energise(struct input *input)
{
    command(FLUXBENCH_OP_IDENTIFY, FLUXBENCH_PROTOCOL_MAJOR);
    fb_poll();
    write_register(FLUXBENCH_REG_LIMIT_CURRENT_A, 5.0f);
    write_register(FLUXBENCH_REG_LIMIT_VOLTAGE_V, 150.0f);
    fb_poll();
    command(FLUXBENCH_OP_ARM, 0u);
    fb_poll();
    write_register(FLUXBENCH_REG_PROGRAM_KIND, (float)(octet(input) & 3u));
    write_register(FLUXBENCH_REG_DURATION_S, 0.02f);
    write_register(FLUXBENCH_REG_SETTLE_S, 0.01f);
    write_register(FLUXBENCH_REG_CONTROL_BANDWIDTH_HZ, 200.0f);
    fb_poll();
    write_register(FLUXBENCH_REG_AMPLITUDE_V, 50.0f);
    write_register(FLUXBENCH_REG_FREQUENCY_HZ, 500.0f);
    write_register(FLUXBENCH_REG_RIPPLE_PERIODS, 1.0f);
    write_register(FLUXBENCH_REG_RIPPLE_CURVATURE, (float)(octet(input) & 1u));
    write_register(FLUXBENCH_REG_PERIOD_S, 0.02f);
    write_register(FLUXBENCH_REG_PERIODS, 1.0f);
    write_register(FLUXBENCH_REG_AMPLITUDE_A, 1.0f);
    fb_poll();
    command(FLUXBENCH_OP_RUN_PROGRAM, 0u);
    fb_poll();
}

static void do_one(struct input *input)
{
    static const uint16_t ids[] = {0x010, 0x020, 0x030, 0x038, 0x03C, 0x040, 0x048, 0x080};
    const uint8_t deed = octet(input) % 12u;
    uint8_t data[64];
    size_t size;

    switch (deed) {
    case 0: /* anything on the line */
        for (size = octet(input) & 31u; size > 0u && line_size < LINE; size--) {
            line[line_size++] = octet(input);
        }
        break;
    case 1: /* any frame */
        size = octet(input) & 15u;
        for (size_t k = 0; k < size; k++) {
            data[k] = octet(input);
        }
        hear(ids[octet(input) & 7u], data, size);
        break;
    case 2:
        pass(octet(input));
        break;
    case 3:
        now_us += word(input) >> (octet(input) & 31u);
        break;
    case 4:
        command(octet(input) & 15u, octet(input));
        break;
    case 5:
        write_register((uint8_t)(octet(input) & 127u), number(input));
        break;
    case 6:
        reading.i_a = number(input);
        reading.i_b = number(input);
        reading.i_c = (octet(input) & 1u) != 0u ? -reading.i_a - reading.i_b : number(input);
        break;
    case 7:
        reading.v_dc = (octet(input) & 3u) != 0u ? 400.0f : number(input);
        gate_fault = octet(input) > 250u;
        celsius = octet(input);
        interlocks = octet(input) > 200u ? octet(input) : (uint8_t)0u;
        break;
    case 8:
        energise(input);
        break;
    case 9: { /* blocks */
        const struct fluxbench_read_block_t request = {(octet(input) & 7u) * 60u + octet(input) / 255u, octet(input) & 63u,
                                                       octet(input), (uint16_t)(word(input) >> 16)};
        const struct fluxbench_read_block_t likely = {(octet(input) & 7u) * 60u, 1u, octet(input), (octet(input) & 3u)};

        (void)fluxbench_read_block_pack(data, (octet(input) & 1u) != 0u ? &request : &likely, 8);
        hear(FLUXBENCH_READ_BLOCK_FRAME_ID, data, 8);
        break;
    }
    case 10:
        beat();
        pass(octet(input) & 127u);
        break;
    default:
        taken_each = octet(input);
        break;
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    struct input input = {data, size};

    memset(&decoder, 0, sizeof(decoder));
    now_us = 0;
    reading = (struct fb_reading){0.0f, 0.0f, 0.0f, 400.0f};
    celsius = 25.0f;
    gates = gate_fault = is_locked = false;
    interlocks = 0u;
    line_size = line_read = 0;
    taken_each = 4096u;
    seq = 0;
    fb_init();
    while (input.size > 0u) {
        do_one(&input);
        fb_poll();
        require_sound();
        if (line_read >= line_size) {
            line_size = line_read = 0;
        }
    }
    return 0;
}
