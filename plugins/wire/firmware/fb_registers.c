#include "fb_registers.h"

#include <stddef.h>
#include <string.h>

#include "fb_board.h"
#include "fb_capture.h"
#include "fb_link.h"
#include "fb_ripple.h"
#include "fluxbench_registers.h"

#define ALL_KINDS 15.0f
#define CURRENT_SPAN 1.5f /* of int16 over the longest current vector */
#define VOLTAGE_SPAN 1.1f
#define BUS_SPAN 1.4f
#define RIPPLE_SPAN 0.5f

static const fluxbench_register_t table[] = {FLUXBENCH_REGISTERS};
static float values[FLUXBENCH_REGISTERS_END];

static const fluxbench_register_t *row(uint8_t index)
{
    for (size_t k = 0; k < sizeof(table) / sizeof(table[0]); k++) {
        if (table[k].index == index) {
            return &table[k];
        }
    }
    return NULL;
}

static void describe_drive(void)
{
    const struct fb_facts *own = &fb_facts;
    uint32_t can = FLUXBENCH_CAN_RIPPLE_ON_DRIVE | FLUXBENCH_CAN_RAW_CAPTURE | FLUXBENCH_CAN_CAPTURE_RING |
                   FLUXBENCH_CAN_F32_CAPTURE | FLUXBENCH_CAN_RIPPLE_CURVATURE;

    can |= own->has_brake ? (uint32_t)FLUXBENCH_CAN_BRAKE : 0u;
    can |= own->has_thermometer ? (uint32_t)FLUXBENCH_CAN_TEMPERATURE : 0u;
    can |= own->has_interlocks ? (uint32_t)FLUXBENCH_CAN_INTERLOCKS : 0u;
    fb_register_set(FLUXBENCH_REG_PROTOCOL_MAJOR, FLUXBENCH_PROTOCOL_MAJOR);
    fb_register_set(FLUXBENCH_REG_PROTOCOL_MINOR, FLUXBENCH_PROTOCOL_MINOR);
    fb_register_set(FLUXBENCH_REG_CAPABILITY_BITS, (float)can);
    fb_register_set(FLUXBENCH_REG_DESCRIPTION_BYTES, (float)strlen(own->description));
    fb_register_set(FLUXBENCH_REG_SAMPLING_FREQUENCY_HZ, own->sampling_hz);
    fb_register_set(FLUXBENCH_REG_PWM_FREQUENCY_HZ, own->pwm_hz);
    fb_register_set(FLUXBENCH_REG_PWM_CHOICE_0, own->pwm_hz);
    fb_register_set(FLUXBENCH_REG_DC_BUS_VOLTAGE_V, own->dc_bus_v);
    fb_register_set(FLUXBENCH_REG_VOLTAGE_DELAY_SAMPLES, own->voltage_delay_samples);
    fb_register_set(FLUXBENCH_REG_MAX_CURRENT_A, own->max_current_a);
    fb_register_set(FLUXBENCH_REG_MAX_VOLTAGE_V, own->max_voltage_v);
    fb_register_set(FLUXBENCH_REG_WATCHDOG_S, own->watchdog_s);
    fb_register_set(FLUXBENCH_REG_WATCHDOG_COVERS, own->watchdog_s > 0.0f ? ALL_KINDS : 0.0f);
    fb_register_set(FLUXBENCH_REG_EXCITATIONS, ALL_KINDS);
    fb_register_set(FLUXBENCH_REG_LONGEST_PROGRAM_S, own->longest_program_s);
    fb_register_set(FLUXBENCH_REG_TEMPERATURE_C, -273.0f);
}

static void describe_captures(void)
{
    const struct fb_facts *own = &fb_facts;

    fb_register_set(FLUXBENCH_REG_CAPTURE_CHANNELS, FB_CAPTURE_CHANNELS);
    fb_register_set(FLUXBENCH_REG_CAPTURE_MEMORY_BYTES, 2.0f * (float)FB_CAPTURE_WORDS);
    fb_register_set(FLUXBENCH_REG_BULK_BLOCK_BYTES, FB_BLOCK_REGISTER);
    fb_register_set(FLUXBENCH_REG_CURRENT_SCALE_A, CURRENT_SPAN * own->max_current_a / 32767.0f);
    fb_register_set(FLUXBENCH_REG_VOLTAGE_SCALE_V, VOLTAGE_SPAN * own->max_voltage_v / 32767.0f);
    fb_register_set(FLUXBENCH_REG_BUS_SCALE_V, BUS_SPAN * own->dc_bus_v / 32767.0f);
    fb_register_set(FLUXBENCH_REG_TEMPERATURE_SCALE_C, 0.01f);
    fb_register_set(FLUXBENCH_REG_RIPPLE_SCALE_A, RIPPLE_SPAN * own->max_current_a / 32767.0f);
    fb_register_set(FLUXBENCH_REG_RIPPLE_RATE_MAX_HZ, FB_RIPPLE_RATE_HZ);
    fb_register_set(FLUXBENCH_REG_RIPPLE_MEMORY_ROWS, FB_RIPPLE_ROWS);
}

void fb_registers_init(void)
{
    for (size_t k = 0; k < sizeof(table) / sizeof(table[0]); k++) {
        values[table[k].index] = table[k].initial;
    }
    describe_drive();
    describe_captures();
}

float fb_register(uint8_t index)
{
    return values[index];
}

bool fb_register_is_on(uint8_t index)
{
    return values[index] > 0.5f;
}

uint32_t fb_register_whole(uint8_t index)
{
    return (uint32_t)values[index];
}

void fb_register_set(uint8_t index, float value)
{
    values[index] = value;
}

bool fb_register_is_there(uint8_t index)
{
    return row(index) != NULL;
}

/* Not finite: an exponent of ones. Asked by the bits, for some compilers take comparisons with NaN away. */
static bool is_number(float value)
{
    uint32_t bits;

    memcpy(&bits, &value, sizeof(bits));
    return (bits & 0x7F800000u) != 0x7F800000u;
}

static uint8_t refused_by_table(const fluxbench_register_t *entry, float value)
{
    if (!is_number(value)) {
        return FLUXBENCH_ACK_NOT_A_NUMBER;
    }
    if (value < entry->low || value > entry->high || (entry->whole != 0u && value > (float)(uint32_t)value)) {
        return FLUXBENCH_ACK_OUT_OF_RANGE;
    }
    return FLUXBENCH_ACK_OK;
}

static uint8_t refused_by_drive(uint8_t index, float value)
{
    uint8_t status = FLUXBENCH_ACK_OK;

    if ((index == FLUXBENCH_REG_LIMIT_CURRENT_A && value > fb_facts.max_current_a) ||
        (index == FLUXBENCH_REG_LIMIT_VOLTAGE_V && value > fb_facts.max_voltage_v)) {
        status = FLUXBENCH_ACK_PAST_LIMIT;
    } else if (index == FLUXBENCH_REG_BRAKE && !fb_facts.has_brake) {
        status = FLUXBENCH_ACK_NOT_SUPPORTED;
    }
    return status;
}

uint8_t fb_register_write(uint8_t index, float value, uint8_t state)
{
    const fluxbench_register_t *entry = row(index);
    uint8_t status;

    if (entry == NULL) {
        return FLUXBENCH_ACK_UNKNOWN;
    }
    if (entry->access == FLUXBENCH_READ) {
        return FLUXBENCH_ACK_READ_ONLY;
    }
    if ((entry->access == FLUXBENCH_SETUP && state != FLUXBENCH_STATE_DISARMED) ||
        state == FLUXBENCH_STATE_RUNNING || state == FLUXBENCH_STATE_STOPPING) {
        return FLUXBENCH_ACK_WRONG_STATE;
    }
    status = refused_by_table(entry, value);
    if (status == FLUXBENCH_ACK_OK) {
        status = refused_by_drive(index, value);
    }
    if (status == FLUXBENCH_ACK_OK) {
        values[index] = value;
        if (index == FLUXBENCH_REG_BRAKE) {
            fb_board_brake(value > 0.5f);
        }
    }
    return status;
}
