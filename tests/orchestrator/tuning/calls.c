/* A run of calls with every answer as hexadecimal words, the same on a host and on a Cortex-M4 (QEMU's mps2-an386, with
 * -icount shift=5: 32 ns an instruction), which prints the instructions of the longest period, too. */
#include "motor_drive.h"

#include <stdint.h>

#define PERIODS 200

static void put(char letter);
static uint32_t clocks(void);

static void put_text(const char *text)
{
    while (*text != '\0')
        put(*text++);
}

static void put_word(uint32_t word)
{
    for (int k = 28; k >= 0; k -= 4)
        put("0123456789abcdef"[(word >> k) & 15u]);
    put(' ');
}

static void put_float(float x)
{
    union { float number; uint32_t bits; } both;
    both.number = x;
    put_word(both.bits);
}

static float between(uint32_t *seed, float low, float high)
{
    *seed = *seed * 1664525u + 1013904223u;
    return low + (high - low) * (float)(*seed >> 8) / 16777216.0f;
}

static uint32_t call_all(void)
{
    motor_current_control control;
    uint32_t seed = 1u, longest = 0u;

    motor_current_control_init(&control);
    for (int k = 0; k < PERIODS; k++) {
        const float omega = between(&seed, -3000.0f, 3000.0f), torque = between(&seed, -12.0f, 12.0f);
        const float noise = between(&seed, -2.0f, 2.0f), v_dc = between(&seed, 280.0f, 320.0f);
        float i_ref[2], i[2] = {noise - 8.0f, noise + 3.0f}, v[2], leg;
        const uint32_t start = clocks();
        motor_corrected_current_a(i, i);
        motor_current_reference_a(torque, omega, v_dc, i_ref);
        const int report = motor_current_control_v(&control, i_ref, i, omega, v_dc, v);
        leg = motor_leg_voltage_v(i[0], v_dc) + motor_leg_voltage_v(i[1], v_dc) + motor_leg_voltage_v(-i[0], v_dc);
        const uint32_t taken = clocks() - start;
        longest = taken > longest ? taken : longest;
        put_word((uint32_t)(report + 1));
        put_float(i_ref[0]);
        put_float(i_ref[1]);
        put_float(v[0]);
        put_float(v[1]);
        put_float(leg);
        put('\n');
    }
    return longest;
}

#ifdef __arm__
#define REGISTER(address) (*(volatile uint32_t *)(address))
#define UART_DATA REGISTER(0x40004000u)
#define UART_CTRL REGISTER(0x40004008u)
#define UART_BAUDDIV REGISTER(0x40004010u)
#define SYSTICK_CTRL REGISTER(0xE000E010u)
#define SYSTICK_LOAD REGISTER(0xE000E014u)
#define SYSTICK_NOW REGISTER(0xE000E018u)
#define CPACR REGISTER(0xE000ED88u)
#define WRAP 0x1000000u

extern uint32_t stack_top[];
void reset(void);

static void put(char letter)
{
    UART_DATA = (uint32_t)letter;
}

/* SysTick counts down at 25 MHz. */
static uint32_t clocks(void)
{
    return WRAP - SYSTICK_NOW;
}

void reset(void)
{
    CPACR |= 0x00F00000u;
    UART_BAUDDIV = 16u;
    UART_CTRL = 1u;
    SYSTICK_LOAD = WRAP - 1u;
    SYSTICK_CTRL = 5u;
    const uint32_t longest = call_all();
    put_text("end ");
    put_word(longest * 40u / 32u); /* of 40 ns against 32 ns an instruction */
    put('\n');
    for (;;) {
    }
}

__attribute__((section(".vectors"), used)) static void *const vectors[2] = {stack_top, reset};
#else
#include <stdio.h>

static void put(char letter)
{
    putchar(letter);
}

static uint32_t clocks(void)
{
    return 0u;
}

int main(void)
{
    const uint32_t longest = call_all();
    put_text("end ");
    put_word(longest);
    put('\n');
    return 0;
}
#endif
