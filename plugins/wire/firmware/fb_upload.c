#include "fb_upload.h"

#include <string.h>

#include "fb_board.h"
#include "fb_capture.h"
#include "fb_line.h"
#include "fb_ripple.h"
#include "fluxbench_registers.h"

#define MOST_REQUESTS 20u
#define END_OCTETS 8u

struct job {
    struct fluxbench_read_block_t request;
    uint16_t blocks; /* of which there are so many */
    uint16_t done;
    bool has_begun;
};

static struct {
    struct job jobs[MOST_REQUESTS];
    uint32_t first, count;
} queue;

/* What is there of a capture. */
struct source {
    uint32_t octets, whole, crc;
};

void fb_upload_init(void)
{
    memset(&queue, 0, sizeof(queue));
}

static uint8_t description_octet(uint32_t offset)
{
    return (uint8_t)((unsigned char)fb_facts.description[offset] & 0xFFu);
}

static void describe(struct source *source)
{
    source->octets = (uint32_t)strlen(fb_facts.description);
    source->whole = source->octets;
    source->crc = FB_CRC_START;
    for (uint32_t k = 0; k < source->octets; k++) {
        source->crc = fb_crc(source->crc, description_octet(k));
    }
}

static bool find(uint16_t number, struct source *source)
{
    bool is_there = true;

    if (number == FLUXBENCH_DESCRIPTION) {
        describe(source);
    } else if (number > FLUXBENCH_RIPPLE) {
        const struct fb_ripple_made made = fb_ripple_made();

        source->octets = made.octets;
        source->whole = made.whole;
        source->crc = made.crc;
        is_there = made.whole > 0u && number == fb_captured().number + FLUXBENCH_RIPPLE;
    } else {
        const struct fb_captured captured = fb_captured();

        source->octets = captured.octets;
        source->whole = captured.whole;
        source->crc = captured.crc;
        is_there = captured.whole > 0u && number == captured.number;
    }
    return is_there;
}

static bool is_overwritten(uint16_t number, uint32_t offset)
{
    return number < FLUXBENCH_RIPPLE && fb_capture_is_overwritten(offset, fb_captured().octets);
}

static uint8_t octet_of(uint16_t number, uint32_t offset)
{
    if (number == FLUXBENCH_DESCRIPTION) {
        return description_octet(offset);
    }
    return number > FLUXBENCH_RIPPLE ? fb_ripple_octet(offset) : fb_capture_octet(offset);
}

uint8_t fb_upload_ask(const struct fluxbench_read_block_t *request)
{
    struct source source;
    const struct job job = {*request, 0, 0, false};
    const uint32_t most = FB_MOST_BLOCKS;

    if (!find(request->capture, &source)) {
        return FLUXBENCH_ACK_NOT_CAPTURED;
    }
    if (request->offset % FB_BLOCK_OCTETS != 0u || request->blocks > most) {
        return FLUXBENCH_ACK_OUT_OF_RANGE;
    }
    if (request->blocks > 0u && is_overwritten(request->capture, request->offset)) {
        return FLUXBENCH_ACK_OVERWRITTEN;
    }
    if (queue.count < MOST_REQUESTS) { /* else the host asks again */
        queue.jobs[(queue.first + queue.count) % MOST_REQUESTS] = job;
        queue.count++;
    }
    return FLUXBENCH_ACK_OK;
}

/* Blocks from the offset on that are full; at the end of a capture also the last one. */
static uint16_t blocks_there(const struct fluxbench_read_block_t *request, const struct source *source)
{
    uint32_t there = 0;

    if (source->octets > request->offset) {
        const uint32_t octets = source->octets - request->offset;
        const bool is_complete = source->octets >= source->whole;

        there = is_complete ? (octets + FB_BLOCK_OCTETS - 1u) / FB_BLOCK_OCTETS : octets / FB_BLOCK_OCTETS;
    }
    return (uint16_t)(there < request->blocks ? there : request->blocks);
}

static void put_little_endian(uint32_t value, uint8_t octets)
{
    for (uint8_t k = 0; k < octets; k++) {
        fb_line_put((uint8_t)((value >> (8u * k)) & 0xFFu));
    }
}

static void put_block(const struct job *job, const struct source *source)
{
    const struct fluxbench_read_block_t *request = &job->request;
    const uint32_t offset = request->offset + (uint32_t)job->done * FB_BLOCK_OCTETS;

    fb_line_begin(FB_BLOCK_ID);
    if (FB_BLOCK_HEADER_OCTETS == 2u) {
        put_little_endian((uint32_t)job->done | ((uint32_t)request->window << 10), 2);
    } else {
        put_little_endian(offset | ((uint32_t)request->window << 26), 4);
    }
    for (uint32_t k = offset; k < offset + FB_BLOCK_OCTETS; k++) {
        fb_line_put(k < source->octets ? octet_of(request->capture, k) : (uint8_t)0u);
    }
    fb_line_end();
    if (is_overwritten(request->capture, offset)) { /* while it was being copied */
        fb_line_drop();
    }
}

static void put_end(const struct job *job, const struct source *source)
{
    const struct fluxbench_bulk_end_t end = {fb_crc_end(source->crc), source->octets, job->request.window};
    uint8_t data[END_OCTETS] = {0u};

    (void)fluxbench_bulk_end_pack(data, &end, END_OCTETS);
    fb_line_begin(FLUXBENCH_BULK_END_FRAME_ID);
    for (uint8_t k = 0; k < END_OCTETS; k++) {
        fb_line_put(data[k]);
    }
    fb_line_end();
}

bool fb_upload_put_next(void)
{
    struct job *job = &queue.jobs[queue.first];
    struct source source;
    bool is_over;

    if (queue.count == 0u) {
        return false;
    }
    is_over = !find(job->request.capture, &source); /* another capture has taken its place */
    if (!is_over) {
        if (!job->has_begun) {
            job->blocks = blocks_there(&job->request, &source);
            job->has_begun = true;
        }
        if (job->done < job->blocks) {
            put_block(job, &source);
            job->done++;
        } else {
            put_end(job, &source);
            is_over = true;
        }
    }
    if (is_over) {
        queue.first = (queue.first + 1u) % MOST_REQUESTS;
        queue.count--;
    }
    return true;
}
