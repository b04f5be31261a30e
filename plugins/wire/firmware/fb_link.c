#include "fb_link.h"

#include <string.h>

#include "fb_time.h"
#include "fb_upload.h"

#define MOST_WAITING 32u
#define MESSAGE_OCTETS 8u
#define MOST_AT_ONCE 16u   /* frames, before the watchdog is asked again */
#define GIVEN_UP_US 250000u /* what nobody took for so long is thrown away */

struct message {
    uint16_t id;
    uint8_t size;
    uint8_t data[MESSAGE_OCTETS];
};

static struct {
    struct message waiting[MOST_WAITING];
    uint32_t first, count;
    uint32_t taken_us;
} queue;

void fb_link_init(void)
{
    memset(&queue, 0, sizeof(queue));
    fb_line_init();
    fb_upload_init();
}

bool fb_link_hear(struct fb_frame *frame)
{
    return fb_line_receive(frame);
}

void fb_link_say(uint16_t id, const uint8_t *data, uint8_t size)
{
    if (queue.count < MOST_WAITING) {
        struct message *message = &queue.waiting[(queue.first + queue.count) % MOST_WAITING];

        message->id = id;
        message->size = size;
        memcpy(message->data, data, size * sizeof(data[0]));
        queue.count++;
    }
}

static bool put_next(void)
{
    bool is_there = queue.count > 0u;

    if (is_there) {
        const struct message *message = &queue.waiting[queue.first];

        fb_line_begin(message->id);
        for (uint8_t k = 0; k < message->size; k++) {
            fb_line_put(message->data[k]);
        }
        fb_line_end();
        queue.first = (queue.first + 1u) % MOST_WAITING;
        queue.count--;
    } else {
        is_there = fb_upload_put_next();
    }
    return is_there;
}

void fb_link_pump(void)
{
    const uint32_t now_us = fb_time_us();

    for (uint32_t frames = 0; frames < MOST_AT_ONCE; frames++) {
        if (!fb_line_flush()) {
            break;
        }
        queue.taken_us = now_us;
        if (!put_next()) {
            return;
        }
    }
    if (now_us - queue.taken_us > GIVEN_UP_US) {
        fb_line_drop();
        queue.count = 0;
        fb_upload_init();
    }
}
