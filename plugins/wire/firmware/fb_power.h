/* The power stage: its state, what it runs, and the protections that need nobody's permission to act. */

#ifndef FB_POWER_H
#define FB_POWER_H

#include <stdbool.h>
#include <stdint.h>

#include "fb_math.h"
#include "fb_plan.h"

/* All there is to say of it, as of one instant. */
struct fb_news {
    uint8_t state, phase, cause;
    uint16_t faults;
    uint8_t open_interlocks;
    float fault_value, fault_limit;
    struct fb_vector shown; /* low-passed current, believed frame [A] */
    struct fb_vector base;  /* frozen voltage of the latest injection [V] */
    float v_dc, energy_j;
    uint32_t tick;
};

void fb_power_init(void);
struct fb_news fb_power_news(void);
bool fb_power_is_energised(uint8_t state);

/* Each returns FLUXBENCH_ACK_OK, or why not. */
uint8_t fb_power_arm(void);
uint8_t fb_power_run(void);
uint8_t fb_power_record_arm(uint32_t rows); /* capture what is held: get ready, and go */
uint8_t fb_power_record(void);

/* Done in any state. */
void fb_power_disarm(void);
void fb_power_clear(void);
void fb_power_stop(void);
void fb_power_feed(void); /* a heartbeat was taken */
void fb_power_trip(uint8_t fault, float value, float limit);

/* The watchdog, the interlocks and the temperature: before the link is read. */
void fb_power_guard(void);

#endif
