/* Who is heard: which request is new, which a repetition, and which heartbeat is a sign of life. */

#ifndef FB_SESSION_H
#define FB_SESSION_H

#include <stdbool.h>
#include <stdint.h>

#include "fluxbench.h"

enum fb_verdict {
    FB_NEW,
    FB_REPEATED, /* send the stored reply again, do nothing */
    FB_OLD,      /* drop it: a late copy */
    FB_STALE     /* of another session: say so, do nothing */
};

void fb_session_init(void);
uint16_t fb_session(void);

/* A request that is new must be answered through fb_session_store(); reads are judged for the sequence alone. */
enum fb_verdict fb_session_judge(uint16_t session, uint8_t seq, bool is_read, bool is_identify);

void fb_session_open(uint16_t session, uint8_t seq); /* of an identify that is granted */
uint16_t fb_session_issue(void);                     /* a new random one, on arming */

/* The reply to the last request, to be sent again for its repetitions. */
void fb_session_store(uint16_t session, uint8_t seq, uint16_t id, const uint8_t *data, uint8_t size);
void fb_session_say_again(void);

/* Heartbeats */
void fb_beat_start(void); /* on arming */
bool fb_beat_is_alive(const struct fluxbench_heartbeat_t *beat);
uint8_t fb_beat_last(void);

#endif
