#include "fb_time.h"

#include "fb_board.h"

static uint32_t born_us, seen_us, ms, rest_us;

void fb_time_init(void)
{
    born_us = fb_board_time_us();
    seen_us = born_us;
    ms = 0;
    rest_us = 0;
}

void fb_time_pass(void)
{
    const uint32_t now_us = fb_board_time_us();
    const uint32_t passed_us = rest_us + (now_us - seen_us);

    seen_us = now_us;
    ms += passed_us / 1000u;
    rest_us = passed_us % 1000u;
}

uint32_t fb_time_us(void)
{
    return fb_board_time_us() - born_us;
}

uint32_t fb_time_ms(void)
{
    return ms;
}
