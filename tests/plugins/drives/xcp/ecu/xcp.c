#include "xcp.h"

#include <stdbool.h>
#include <string.h>

#include "fluxbench_xcp.h"

#define MOST_ENTRIES 16u

/* Commands and errors by their numbers in ASAM MCD-1 XCP, part 2. */
enum {
    CONNECT = 0xFF, DISCONNECT = 0xFE, GET_STATUS = 0xFD, SYNCH = 0xFC, SET_MTA = 0xF6, UPLOAD = 0xF5,
    DOWNLOAD = 0xF0, SET_DAQ_PTR = 0xE2, WRITE_DAQ = 0xE1, SET_DAQ_LIST_MODE = 0xE0, START_STOP_DAQ_LIST = 0xDE,
    START_STOP_SYNCH = 0xDD, GET_DAQ_PROCESSOR_INFO = 0xDA, GET_DAQ_RESOLUTION_INFO = 0xD9, FREE_DAQ = 0xD6,
    ALLOC_DAQ = 0xD5, ALLOC_ODT = 0xD4, ALLOC_ODT_ENTRY = 0xD3
};
enum { ERR_CMD_SYNCH = 0x00, ERR_CMD_UNKNOWN = 0x20, ERR_OUT_OF_RANGE = 0x22, ERR_ACCESS_DENIED = 0x24, ERR_SEQUENCE = 0x29 };

static struct {
    bool connected, runs;
    uint32_t mta;
    uint32_t address[MOST_ENTRIES];
    uint8_t size[MOST_ENTRIES];
    unsigned entries, at;
} slave;

static uint32_t word_at(const uint8_t *octets)
{
    return (uint32_t)octets[0] | (uint32_t)octets[1] << 8 | (uint32_t)octets[2] << 16 | (uint32_t)octets[3] << 24;
}

static uint8_t *memory(uint32_t address, size_t octets)
{
    const uintptr_t begin = (uintptr_t)&fluxbench;

    return address >= begin && address + octets <= begin + sizeof(fluxbench) ? (uint8_t *)(uintptr_t)address : NULL;
}

static size_t error(uint8_t which, uint8_t *answer)
{
    answer[0] = 0xFE;
    answer[1] = which;
    return 2u;
}

static size_t said(const uint8_t *octets, size_t count, uint8_t *answer)
{
    answer[0] = 0xFF;
    memcpy(answer + 1, octets, count);
    return count + 1u;
}

static size_t done(uint8_t *answer)
{
    return said(answer, 0u, answer);
}

static size_t connected(uint8_t *answer)
{
    /* calibration and DAQ; Intel, octets; most of a command, of a message; versions of protocol and transport */
    const uint8_t told[] = {0x05, 0x00, XCP_MOST_CTO, XCP_MOST_DTO & 255u, XCP_MOST_DTO >> 8, 1, 1};

    slave.connected = true;
    slave.runs = false;
    return said(told, sizeof(told), answer);
}

static size_t upload(size_t octets, uint8_t *answer)
{
    const uint8_t *from = memory(slave.mta, octets);

    if (from == NULL || octets >= XCP_MOST_CTO) {
        return error(ERR_ACCESS_DENIED, answer);
    }
    slave.mta += (uint32_t)octets;
    return said(from, octets, answer);
}

static size_t download(const uint8_t *octets, size_t count, uint8_t *answer)
{
    uint8_t *to = memory(slave.mta, count);

    if (to == NULL) {
        return error(ERR_ACCESS_DENIED, answer);
    }
    memcpy(to, octets, count);
    slave.mta += (uint32_t)count;
    return done(answer);
}

static size_t write_daq(const uint8_t *command, uint8_t *answer)
{
    const uint32_t address = word_at(command + 4);

    if (slave.at >= slave.entries || memory(address, command[2]) == NULL) {
        return error(ERR_OUT_OF_RANGE, answer);
    }
    slave.size[slave.at] = command[2];
    slave.address[slave.at] = address;
    slave.at++;
    return done(answer);
}

static size_t measured(const uint8_t *command, uint8_t *answer)
{
    const uint8_t processor[] = {0x01, 1, 0, 1, 0, 0, 0x00};      /* dynamic lists; absolute ODT numbers */
    const uint8_t resolution[] = {1, 8, 1, 8, 0x00, 1, 0};        /* entries of 1 to 8 octets; no time stamp */
    const uint8_t first[] = {0};

    switch (command[0]) {
    case GET_DAQ_PROCESSOR_INFO:
        return said(processor, sizeof(processor), answer);
    case GET_DAQ_RESOLUTION_INFO:
        return said(resolution, sizeof(resolution), answer);
    case FREE_DAQ:
        slave.runs = false;
        slave.entries = 0u;
        return done(answer);
    case ALLOC_DAQ:
    case ALLOC_ODT:
        return command[command[0] == ALLOC_DAQ ? 2 : 4] == 1u ? done(answer) : error(ERR_OUT_OF_RANGE, answer);
    case ALLOC_ODT_ENTRY:
        slave.entries = command[5];
        return slave.entries <= MOST_ENTRIES ? done(answer) : error(ERR_OUT_OF_RANGE, answer);
    case SET_DAQ_PTR:
        slave.at = command[5];
        return done(answer);
    case WRITE_DAQ:
        return write_daq(command, answer);
    case SET_DAQ_LIST_MODE:
        return command[4] == 0u ? done(answer) : error(ERR_OUT_OF_RANGE, answer); /* the one event */
    case START_STOP_DAQ_LIST:
        if (slave.at != slave.entries) {
            return error(ERR_SEQUENCE, answer);
        }
        slave.runs = command[1] != 0u;
        return said(first, sizeof(first), answer);
    case START_STOP_SYNCH:
        slave.runs = command[1] == 1u;
        return done(answer);
    default:
        return error(ERR_CMD_UNKNOWN, answer);
    }
}

size_t xcp_answer(const uint8_t *command, size_t octets, uint8_t *answer)
{
    uint8_t whole[XCP_MOST_CTO] = {0};
    const uint8_t status[] = {slave.runs ? 0x40 : 0x00, 0, 0, 0, 0};

    memcpy(whole, command, octets < sizeof(whole) ? octets : sizeof(whole));
    if (whole[0] == CONNECT) {
        return connected(answer);
    }
    if (!slave.connected) {
        return 0u; /* as the standard has it */
    }
    switch (whole[0]) {
    case DISCONNECT:
        xcp_forget();
        return done(answer);
    case GET_STATUS:
        return said(status, sizeof(status), answer);
    case SYNCH:
        return error(ERR_CMD_SYNCH, answer);
    case SET_MTA:
        slave.mta = word_at(whole + 4);
        return done(answer);
    case UPLOAD:
        return upload(whole[1], answer);
    case DOWNLOAD:
        return whole[1] + 2u <= octets ? download(whole + 2, whole[1], answer) : error(ERR_OUT_OF_RANGE, answer);
    default:
        return measured(whole, answer);
    }
}

size_t xcp_event(uint8_t *message)
{
    size_t octets = 1u;

    if (!slave.runs) {
        return 0u;
    }
    message[0] = 0u; /* the ODT */
    for (unsigned k = 0u; k < slave.entries; k++) {
        memcpy(message + octets, memory(slave.address[k], slave.size[k]), slave.size[k]);
        octets += slave.size[k];
    }
    return octets;
}

void xcp_forget(void)
{
    slave.connected = slave.runs = false;
}
