#include "fb_control.h"

#include <stdbool.h>

#define NEARLY 18446744074u /* 1e-9 of a period, in 2^-64: so close below a corner counts as the corner */
#define TURN 2.3283064e-10f /* 2^-32 */

static bool is_longer(struct fb_vector v, float most)
{
    return fb_square(v) > most * most;
}

struct fb_vector fb_limited(struct fb_vector v, float most)
{
    struct fb_vector limited = v;

    if (is_longer(v, most)) {
        const float scale = most * fb_rsqrt(fb_square(v));

        limited.x *= scale;
        limited.y *= scale;
    }
    return limited;
}

struct fb_vector fb_control(struct fb_loop *loop, const struct fb_tuning *tuning, const struct fb_piece *piece,
                            uint32_t k, struct fb_vector i, float most_v)
{
    const struct fb_tuning *t = tuning;
    const struct fb_vector want = {piece->start.x + piece->slope.x * (float)k,
                                   piece->start.y + piece->slope.y * (float)k};
    const struct fb_vector error = {want.x - i.x, want.y - i.y};
    const struct fb_vector asked = {
        t->resistance_ohm * want.x + t->inductance.x * piece->slope.x + t->proportional.x * error.x + loop->integral.x,
        t->resistance_ohm * want.y + t->inductance.y * piece->slope.y + t->proportional.y * error.y + loop->integral.y,
    };
    const struct fb_vector given = fb_limited(asked, most_v);

    loop->integral.x += t->integral.x * (error.x + (given.x - asked.x) * t->per_proportional.x);
    loop->integral.y += t->integral.y * (error.y + (given.y - asked.y) * t->per_proportional.y);
    loop->set_point.x = want.x + piece->slope.x;
    loop->set_point.y = want.y + piece->slope.y;
    return given;
}

void fb_start_injection(struct fb_loop *loop)
{
    loop->wave = NEARLY;
    loop->turn = 0u;
}

/* f: +1 in the first half of a period, -1 in the second; g: its integral, a triangle from -1 at phase 0 to +1 at 1/2. */
static void square_wave(uint32_t phase, uint32_t acting, struct fb_injected *injected)
{
    const float past_middle = (float)acting * TURN - 0.5f;

    injected->wave = phase < 0x80000000u ? 1.0f : -1.0f;
    injected->ripple = 1.0f - 4.0f * (past_middle < 0.0f ? -past_middle : past_middle);
}

static void sine_wave(uint32_t phase, uint32_t acting, struct fb_injected *injected)
{
    injected->wave = fb_direction(phase).y;
    injected->ripple = -fb_direction(acting).x;
}

struct fb_injected fb_inject(struct fb_loop *loop, const struct fb_wave *wave)
{
    const struct fb_vector direction = fb_direction((uint32_t)(loop->turn >> 32));
    const uint32_t phase = (uint32_t)(loop->wave >> 32);
    const uint32_t acting = (uint32_t)((loop->wave - wave->delay) >> 32);
    struct fb_injected injected;

    if (wave->square) {
        square_wave(phase, acting, &injected);
    } else {
        sine_wave(phase, acting, &injected);
    }
    injected.volts.x = wave->amplitude_v * injected.wave * direction.x;
    injected.volts.y = wave->amplitude_v * injected.wave * direction.y;
    loop->wave += wave->cycles;
    loop->turn += wave->turns;
    return injected;
}
