#include "fb_session.h"

#include <string.h>

#include "fb_board.h"
#include "fb_link.h"
#include "fb_time.h"

#define HALF_CIRCLE 128u
#define REMEMBERED 16u /* closed sessions */
#define DELAYS 64u     /* of heartbeats */
#define REPLY_OCTETS 8u

static struct {
    uint16_t open;
    uint8_t seq;
    bool has_reply;
    uint16_t last_session;
    uint8_t last_seq;
    uint16_t closed[REMEMBERED];
    uint8_t next_closed;
    uint32_t chance;
    uint16_t reply_id;
    uint8_t reply_size;
    uint8_t reply[REPLY_OCTETS];
} ledger;

static struct {
    uint8_t last;
    bool is_first;
    uint32_t delays[DELAYS]; /* ms, by the host's clock against the drive's: only differences mean something */
    uint8_t count, next;
} beats;

void fb_session_init(void)
{
    memset(&ledger, 0, sizeof(ledger));
    memset(&beats, 0, sizeof(beats));
}

uint16_t fb_session(void)
{
    return ledger.open;
}

static bool is_newer(uint8_t seq, uint8_t than)
{
    const uint32_t ahead = ((uint32_t)seq - than) & 0xFFu;

    return ahead > 0u && ahead < HALF_CIRCLE;
}

static bool is_closed(uint16_t session)
{
    bool found = false;

    for (uint8_t k = 0; k < REMEMBERED; k++) {
        found = found || ledger.closed[k] == session;
    }
    return found;
}

enum fb_verdict fb_session_judge(uint16_t session, uint8_t seq, bool is_read, bool is_identify)
{
    enum fb_verdict verdict = FB_NEW;

    ledger.chance = ledger.chance * 1664525u + 1013904223u + fb_time_us(); /* when requests come is chance enough */
    if (!is_read && ledger.has_reply && session == ledger.last_session && seq == ledger.last_seq) {
        verdict = FB_REPEATED;
    } else if (session != ledger.open || session == 0u) {
        verdict = is_identify && session != 0u && !is_closed(session) ? FB_NEW : FB_STALE;
    } else if (!is_newer(seq, ledger.seq)) {
        verdict = FB_OLD;
    } else {
        ledger.seq = seq;
    }
    return verdict;
}

static void close_session(void)
{
    ledger.closed[ledger.next_closed] = ledger.open;
    ledger.next_closed = (uint8_t)((ledger.next_closed + 1u) % REMEMBERED);
}

void fb_session_open(uint16_t session, uint8_t seq)
{
    if (session != ledger.open) {
        close_session();
        ledger.open = session;
        ledger.seq = seq;
    }
}

uint16_t fb_session_issue(void)
{
    uint16_t session;

    close_session();
    do {
        ledger.chance = ledger.chance * 1664525u + 1013904223u;
        session = (uint16_t)(ledger.chance >> 16);
    } while (session == 0u || is_closed(session));
    ledger.open = session;
    return session;
}

void fb_session_store(uint16_t session, uint8_t seq, uint16_t id, const uint8_t *data, uint8_t size)
{
    ledger.has_reply = true;
    ledger.last_session = session;
    ledger.last_seq = seq;
    ledger.reply_id = id;
    ledger.reply_size = size;
    memcpy(ledger.reply, data, size * sizeof(data[0]));
    fb_session_say_again();
}

void fb_session_say_again(void)
{
    fb_link_say(ledger.reply_id, ledger.reply, ledger.reply_size);
}

/* Heartbeats */

void fb_beat_start(void)
{
    beats.is_first = true;
    beats.count = 0;
    beats.next = 0;
}

/* By how much it was longer under way than the quickest of the last ones [ms]; all wrap. */
static int32_t lateness(uint32_t delay)
{
    int32_t late = 0;

    for (uint8_t k = 0; k < beats.count; k++) {
        const int32_t behind = (int32_t)(delay - beats.delays[k]);

        late = behind > late ? behind : late;
    }
    return late;
}

static void remember(uint32_t delay)
{
    beats.delays[beats.next] = delay;
    beats.next = (uint8_t)((beats.next + 1u) % DELAYS);
    beats.count = beats.count < DELAYS ? (uint8_t)(beats.count + 1u) : (uint8_t)DELAYS;
}

bool fb_beat_is_alive(const struct fluxbench_heartbeat_t *beat)
{
    const uint32_t delay = fb_time_ms() - beat->host_ms;
    int32_t late;

    if (beat->session != ledger.open || !(beats.is_first || is_newer(beat->seq, beats.last))) {
        return false;
    }
    late = lateness(delay);
    remember(delay);
    beats.last = beat->seq;
    beats.is_first = false;
    return (float)late <= 1e3f * fb_facts.watchdog_s;
}

uint8_t fb_beat_last(void)
{
    return beats.last;
}
