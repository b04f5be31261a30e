#include "fb_dispatch.h"

#include <stdbool.h>

#include "fb_capture.h"
#include "fb_link.h"
#include "fb_power.h"
#include "fb_registers.h"
#include "fb_session.h"
#include "fb_telemetry.h"
#include "fb_upload.h"
#include "fluxbench.h"
#include "fluxbench_registers.h"

#define OCTETS 8u
#define VERSION (FLUXBENCH_PROTOCOL_MAJOR * 256 + FLUXBENCH_PROTOCOL_MINOR)

/* A request's answer, before it is packed. */
struct answer {
    uint8_t status;
    uint16_t value;
};

static uint8_t pack_ack(uint8_t *data, uint16_t session, uint8_t seq, uint8_t op, struct answer answer)
{
    const struct fluxbench_ack_t ack = {session, seq, op, answer.status, fb_power_news().state, answer.value};

    (void)fluxbench_ack_pack(data, &ack, OCTETS);
    return FLUXBENCH_ACK_LENGTH;
}

static void say_ack(uint16_t session, uint8_t seq, uint8_t op, uint8_t status)
{
    const struct answer answer = {status, 0u};
    uint8_t data[OCTETS] = {0u};
    const uint8_t size = pack_ack(data, session, seq, op, answer);

    fb_link_say(FLUXBENCH_ACK_FRAME_ID, data, size);
}

static uint8_t pack_value(uint8_t *data, uint16_t session, uint8_t seq, uint8_t index)
{
    const struct fluxbench_parameter_value_t value = {session, seq, index, fb_register(index)};

    (void)fluxbench_parameter_value_pack(data, &value, OCTETS);
    return FLUXBENCH_PARAMETER_VALUE_LENGTH;
}

/* Commands */

static struct answer identify(const struct fluxbench_command_t *command)
{
    struct answer answer = {FLUXBENCH_ACK_OK, VERSION};

    if (fb_power_is_energised(fb_power_news().state) && command->session != fb_session()) {
        answer.status = FLUXBENCH_ACK_BUSY;
    } else {
        fb_session_open(command->session, command->seq);
        fb_register_set(FLUXBENCH_REG_RIPPLE_CURVATURE, 0.0f); /* a host of version 1.0 does not write it */
        if (command->arg != (uint32_t)FLUXBENCH_PROTOCOL_MAJOR) {
            answer.status = FLUXBENCH_ACK_WRONG_VERSION;
        }
    }
    return answer;
}

static struct answer arm(void)
{
    struct answer answer = {fb_power_arm(), 0u};

    if (answer.status == FLUXBENCH_ACK_OK) {
        fb_beat_start();
        answer.value = fb_session_issue();
    } else if (answer.status == FLUXBENCH_ACK_INTERLOCK_OPEN) {
        answer.value = fb_power_news().open_interlocks;
    } else {
        /* why not is all there is to say */
    }
    return answer;
}

static struct answer with_capture_number(uint8_t status)
{
    const struct answer answer = {status, status == FLUXBENCH_ACK_OK ? fb_captured().number : (uint16_t)0u};

    return answer;
}

static struct answer obey(const struct fluxbench_command_t *command)
{
    struct answer answer = {FLUXBENCH_ACK_OK, 0u};

    switch (command->op) {
    case FLUXBENCH_OP_IDENTIFY:
        answer = identify(command);
        break;
    case FLUXBENCH_OP_ARM:
        answer = arm();
        break;
    case FLUXBENCH_OP_DISARM:
        fb_power_disarm();
        break;
    case FLUXBENCH_OP_CLEAR_FAULT:
        fb_power_clear();
        break;
    case FLUXBENCH_OP_RUN_PROGRAM:
        answer = with_capture_number(fb_power_run());
        break;
    case FLUXBENCH_OP_STOP:
        fb_power_stop();
        break;
    case FLUXBENCH_OP_CAPTURE_ARM:
        answer = with_capture_number(fb_power_record_arm(command->arg));
        break;
    case FLUXBENCH_OP_CAPTURE_TRIGGER:
        answer = with_capture_number(fb_power_record());
        break;
    case FLUXBENCH_OP_TIME_SYNC:
        break;
    default:
        answer.status = FLUXBENCH_ACK_UNKNOWN;
        break;
    }
    return answer;
}

/* Whether a request is to be done; all else is answered here. */
static bool is_to_be_done(uint16_t session, uint8_t seq, uint8_t op)
{
    const enum fb_verdict verdict = fb_session_judge(session, seq, false, op == FLUXBENCH_OP_IDENTIFY);

    if (verdict == FB_REPEATED) {
        fb_session_say_again();
    } else if (verdict == FB_STALE) {
        say_ack(session, seq, op, FLUXBENCH_ACK_STALE_SESSION);
    } else {
        /* old ones are dropped */
    }
    return verdict == FB_NEW;
}

static void take_command(const struct fluxbench_command_t *command)
{
    uint8_t data[OCTETS] = {0u};

    if (is_to_be_done(command->session, command->seq, command->op)) {
        const struct answer answer = obey(command);
        const uint8_t size = pack_ack(data, command->session, command->seq, command->op, answer);

        fb_session_store(command->session, command->seq, FLUXBENCH_ACK_FRAME_ID, data, size);
        if (command->op == FLUXBENCH_OP_TIME_SYNC) {
            fb_telemetry_say_tick();
        }
    }
}

static void take_write(const struct fluxbench_parameter_write_t *write)
{
    uint8_t data[OCTETS] = {0u};

    if (is_to_be_done(write->session, write->seq, FLUXBENCH_OP_PARAMETER_WRITE)) {
        const struct answer answer = {fb_register_write(write->parameter, write->value, fb_power_news().state), 0u};

        if (answer.status == FLUXBENCH_ACK_OK) {
            const uint8_t size = pack_value(data, write->session, write->seq, write->parameter);

            fb_session_store(write->session, write->seq, FLUXBENCH_PARAMETER_VALUE_FRAME_ID, data, size);
        } else {
            const uint8_t size = pack_ack(data, write->session, write->seq, FLUXBENCH_OP_PARAMETER_WRITE, answer);

            fb_session_store(write->session, write->seq, FLUXBENCH_ACK_FRAME_ID, data, size);
        }
    }
}

static void refresh(void)
{
    const struct fb_news news = fb_power_news();
    const uint32_t start = fb_captured().start;

    fb_register_set(FLUXBENCH_REG_FAULT_CAUSE, (float)news.cause);
    fb_register_set(FLUXBENCH_REG_FAULT_BITS, (float)news.faults);
    fb_register_set(FLUXBENCH_REG_FAULT_VALUE, news.fault_value);
    fb_register_set(FLUXBENCH_REG_FAULT_LIMIT, news.fault_limit);
    fb_register_set(FLUXBENCH_REG_ENERGY_USED_J, news.energy_j < 1e9f ? news.energy_j : 1e9f);
    fb_register_set(FLUXBENCH_REG_CAPTURE_START_LOW, (float)(start & 0xFFFFu));
    fb_register_set(FLUXBENCH_REG_CAPTURE_START_HIGH, (float)(start >> 16));
    fb_register_set(FLUXBENCH_REG_BASE_VOLTAGE_D_V, news.base.x);
    fb_register_set(FLUXBENCH_REG_BASE_VOLTAGE_Q_V, news.base.y);
}

static void take_read(const struct fluxbench_parameter_read_t *read)
{
    uint8_t data[OCTETS] = {0u};

    (void)fb_session_judge(read->session, read->seq, true, false);
    if (fb_register_is_there(read->parameter)) {
        refresh();
        (void)pack_value(data, read->session, read->seq, read->parameter);
        fb_link_say(FLUXBENCH_PARAMETER_VALUE_FRAME_ID, data, FLUXBENCH_PARAMETER_VALUE_LENGTH);
    } else {
        say_ack(read->session, read->seq, FLUXBENCH_OP_PARAMETER_READ, FLUXBENCH_ACK_UNKNOWN);
    }
}

static void take_read_block(const struct fluxbench_read_block_t *request)
{
    const uint8_t status = fb_upload_ask(request);

    if (status != FLUXBENCH_ACK_OK) {
        say_ack(fb_session(), request->window, FLUXBENCH_OP_READ_BLOCK, status);
    }
}

void fb_dispatch(const struct fb_frame *frame)
{
    struct fluxbench_heartbeat_t beat;
    struct fluxbench_command_t command;
    struct fluxbench_parameter_write_t write;
    struct fluxbench_parameter_read_t read;
    struct fluxbench_setpoint_t setpoint;
    struct fluxbench_read_block_t request;

    switch (frame->id) {
    case FLUXBENCH_E_STOP_FRAME_ID:
        fb_power_trip(FLUXBENCH_FAULT_EMERGENCY_STOP, 0.0f, 0.0f);
        break;
    case FLUXBENCH_HEARTBEAT_FRAME_ID:
        if (fluxbench_heartbeat_unpack(&beat, frame->data, frame->size) == 0 &&
            fb_power_is_energised(fb_power_news().state) && fb_beat_is_alive(&beat)) {
            fb_power_feed();
        }
        break;
    case FLUXBENCH_COMMAND_FRAME_ID:
        if (fluxbench_command_unpack(&command, frame->data, frame->size) == 0) {
            take_command(&command);
        }
        break;
    case FLUXBENCH_PARAMETER_WRITE_FRAME_ID:
        if (fluxbench_parameter_write_unpack(&write, frame->data, frame->size) == 0) {
            take_write(&write);
        }
        break;
    case FLUXBENCH_PARAMETER_READ_FRAME_ID:
        if (fluxbench_parameter_read_unpack(&read, frame->data, frame->size) == 0) {
            take_read(&read);
        }
        break;
    case FLUXBENCH_SETPOINT_FRAME_ID: /* not among the capabilities */
        if (fluxbench_setpoint_unpack(&setpoint, frame->data, frame->size) == 0 &&
            setpoint.session_low == (fb_session() & 15u)) {
            say_ack(fb_session(), setpoint.seq, FLUXBENCH_OP_SETPOINT, FLUXBENCH_ACK_NOT_SUPPORTED);
        }
        break;
    case FLUXBENCH_READ_BLOCK_FRAME_ID:
        if (fluxbench_read_block_unpack(&request, frame->data, frame->size) == 0) {
            take_read_block(&request);
        }
        break;
    default:
        break;
    }
}
