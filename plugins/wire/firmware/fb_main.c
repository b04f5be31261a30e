/* The main loop's turn: watchdog, link, telemetry, line, in this order. */

#include "fb_board.h"
#include "fb_capture.h"
#include "fb_dispatch.h"
#include "fb_link.h"
#include "fb_power.h"
#include "fb_registers.h"
#include "fb_ripple.h"
#include "fb_session.h"
#include "fb_telemetry.h"
#include "fb_time.h"

#define FRAMES_A_TURN 16u

void fb_init(void)
{
    fb_time_init();
    fb_capture_init();
    fb_ripple_init();
    fb_power_init();
    fb_registers_init();
    fb_session_init();
    fb_link_init();
    fb_telemetry_init();
}

void fb_poll(void)
{
    struct fb_frame frame;

    fb_time_pass();
    for (uint32_t frames = 0; frames < FRAMES_A_TURN; frames++) {
        fb_power_guard(); /* before the link is read: nothing late feeds the watchdog */
        if (!fb_link_hear(&frame)) {
            break;
        }
        fb_dispatch(&frame);
    }
    fb_telemetry_say();
    fb_link_pump();
}
