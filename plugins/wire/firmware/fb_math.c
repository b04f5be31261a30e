#include "fb_math.h"

#include <string.h>

/* Newton's iteration from a first guess by the exponent; three steps reach single precision. */
float fb_rsqrt(float x)
{
    uint32_t bits;
    float y;

    memcpy(&bits, &x, sizeof(bits));
    bits = 0x5F375A86u - (bits >> 1);
    memcpy(&y, &bits, sizeof(y));
    for (uint8_t step = 0; step < 3u; step++) {
        y *= 1.5f - 0.5f * x * y * y;
    }
    return y;
}

float fb_reciprocal(float x)
{
    const float y = fb_rsqrt(x);

    return y * y;
}

/* Taylor's series over an eighth of a turn to either side (error 3e-8), then by quadrant. */
struct fb_vector fb_direction(uint32_t turn)
{
    const uint32_t quadrant = ((turn + 0x20000000u) >> 30) & 3u;
    const float x = (float)(int32_t)(turn - (quadrant << 30)) * 1.4629181e-9f; /* 2 pi / 2^32 */
    const float xx = x * x;
    const float s = x * (1.0f + xx * (-1.6666667e-1f + xx * (8.3333333e-3f + xx * (-1.9841270e-4f + xx * 2.7557319e-6f))));
    const float c = 1.0f + xx * (-0.5f + xx * (4.1666667e-2f + xx * (-1.3888889e-3f + xx * 2.4801587e-5f)));
    struct fb_vector direction;

    switch (quadrant) {
    case 0u:
        direction.x = c;
        direction.y = s;
        break;
    case 1u:
        direction.x = -s;
        direction.y = c;
        break;
    case 2u:
        direction.x = -c;
        direction.y = -s;
        break;
    default:
        direction.x = s;
        direction.y = -c;
        break;
    }
    return direction;
}

uint32_t fb_turn_of(float radians)
{
    const double turns = (double)radians * 0.15915494309189535;
    const int32_t whole = (int32_t)turns - 1; /* below, whatever the sign */

    return (uint32_t)(fb_phase(turns - (double)whole) >> 32);
}

struct fb_vector fb_turned(struct fb_vector v, struct fb_vector by)
{
    const struct fb_vector turned = {by.x * v.x - by.y * v.y, by.y * v.x + by.x * v.y};

    return turned;
}

struct fb_vector fb_turned_back(struct fb_vector v, struct fb_vector by)
{
    const struct fb_vector turned = {by.x * v.x + by.y * v.y, by.x * v.y - by.y * v.x};

    return turned;
}

float fb_square(struct fb_vector v)
{
    return v.x * v.x + v.y * v.y;
}

float fb_length(struct fb_vector v)
{
    const float square = fb_square(v);

    return square > 0.0f ? square * fb_rsqrt(square) : 0.0f;
}

void fb_add(struct fb_sum *sum, float value)
{
    const float added = value - sum->rest;
    const float total = sum->total + added;

    sum->rest = (total - sum->total) - added;
    sum->total = total;
}

int16_t fb_counts(float value, float counts_per_unit)
{
    const float counts = value * counts_per_unit;
    int32_t rounded;

    if (counts >= 32767.0f) {
        rounded = 32767;
    } else if (counts <= -32768.0f) {
        rounded = -32768;
    } else {
        rounded = (int32_t)(counts + (counts < 0.0f ? -0.5f : 0.5f));
    }
    return (int16_t)rounded;
}

uint64_t fb_phase(double periods)
{
    const double fraction = periods - (double)(uint32_t)periods;
    const double counts = fraction * 4294967296.0;
    const uint32_t high = (uint32_t)counts;
    const uint32_t low = (uint32_t)((counts - (double)high) * 4294967296.0);

    return ((uint64_t)high << 32) | low;
}
