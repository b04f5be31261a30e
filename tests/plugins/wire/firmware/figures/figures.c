/* What the sampling interrupt costs: each program on a Cortex-M4 under QEMU with -icount shift=5 (32 ns an instruction),
   without a host. Prints a line a program: name, longest, mean, in instructions. */

#include "fb_board.h"
#include "fb_capture.h"
#include "fb_power.h"
#include "fb_registers.h"
#include "fluxbench_registers.h"
#include "motor.h"

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define UART_DATA REGISTER(0x40004000u)
#define UART_CTRL REGISTER(0x40004008u)
#define UART_BAUDDIV REGISTER(0x40004010u)
#define SYSTICK_CTRL REGISTER(0xE000E010u)
#define SYSTICK_LOAD REGISTER(0xE000E014u)
#define SYSTICK_NOW REGISTER(0xE000E018u)
#define CPACR REGISTER(0xE000ED88u)
#define WRAP 0x1000000u
#define INSTRUCTIONS(clocks) ((clocks) * 40u / 32u) /* 25 MHz against 32 ns */

const struct fb_facts fb_facts = {
    .sampling_hz = 10000.0f, .pwm_hz = 10000.0f, .dc_bus_v = MOTOR_BUS_V, .voltage_delay_samples = 1.0f,
    .max_current_a = 6.0f, .max_voltage_v = 230.0f, .sensor_span_a = 15.9f, .trip_ratio = 1.2f, .overload_s = 120.0f,
    .watchdog_s = 0.2f, .longest_program_s = 60.0f, .resistance_ohm = 4.25f, .l_d_h = 0.04325f, .l_q_h = 0.06905f,
    .rated_a = 2.35f, .description = "name: figures",
};

static struct motor motor;

uint32_t fb_board_time_us(void) { return 0u; }
void fb_board_lock(void) {}
void fb_board_unlock(void) {}
void fb_board_duties(float a, float b, float c) { motor_set_duties(&motor, a, b, c); }
void fb_board_gates(bool on) { motor.gates = on; }
bool fb_board_gate_fault(void) { return false; }
float fb_board_temperature_c(void) { return 25.0f; }
void fb_board_brake(bool engaged) { (void)engaged; }
uint8_t fb_board_interlocks(void) { return 0u; }
size_t fb_board_receive(uint8_t *octets, size_t most) { (void)octets; (void)most; return 0u; }
size_t fb_board_send(const uint8_t *octets, size_t count) { (void)octets; return count; }

static struct fb_reading now; /* read beforehand, so that the motor's own cost is not counted */
void fb_board_read(struct fb_reading *reading) { *reading = now; }

static void say(const char *text)
{
    while (*text != '\0') {
        UART_DATA = (uint32_t)*text++;
    }
}

static void say_number(uint32_t value)
{
    char digits[12];
    int k = 11;

    digits[k] = '\0';
    do {
        digits[--k] = (char)('0' + value % 10u);
        value /= 10u;
    } while (value > 0u);
    say(&digits[k]);
}

static void set(uint8_t index, float value) { fb_register_set(index, value); }

static void run(const char *name, float kind, float mask, float f32, float ripple, float waveform)
{
    uint32_t longest = 0, total = 0, count = 0;

    set(FLUXBENCH_REG_PROGRAM_KIND, kind);
    set(FLUXBENCH_REG_CAPTURE_MASK, mask);
    set(FLUXBENCH_REG_CAPTURE_FORMAT, f32);
    set(FLUXBENCH_REG_RIPPLE_PERIODS, ripple);
    set(FLUXBENCH_REG_WAVEFORM, waveform);
    say(name);
    if (fb_power_run() != FLUXBENCH_ACK_OK) {
        say(" refused\n");
        return;
    }
    while (fb_power_news().state == FLUXBENCH_STATE_RUNNING) {
        uint32_t clocks;

        motor_read(&motor, &now.i_a, &now.i_b);
        now.v_dc = MOTOR_BUS_V;
        clocks = SYSTICK_NOW;
        fb_sample();
        clocks = (clocks + WRAP - SYSTICK_NOW) % WRAP;
        motor_pass(&motor, 1e-4f);
        longest = clocks > longest ? clocks : longest;
        total += clocks;
        count++;
    }
    say(" ");
    say_number(INSTRUCTIONS(longest));
    say(" ");
    say_number(INSTRUCTIONS(total) / count);
    say(fb_power_news().state == FLUXBENCH_STATE_HOLDING ? " done\n" : " faulted\n");
}

extern uint32_t data_begin[], data_end[], data_image[], bss_begin[], bss_end[], stack_top[];
void reset(void);

void reset(void)
{
    const uint32_t *from = data_image;

    CPACR |= 0x00F00000u;
    for (uint32_t *to = data_begin; to < data_end; to++) {
        *to = *from++;
    }
    for (uint32_t *to = bss_begin; to < bss_end; to++) {
        *to = 0u;
    }
    UART_BAUDDIV = 16u;
    UART_CTRL = 1u;
    SYSTICK_LOAD = WRAP - 1u;
    SYSTICK_CTRL = 5u;
    motor_init(&motor);
    fb_init();
    set(FLUXBENCH_REG_LIMIT_CURRENT_A, 4.5f);
    set(FLUXBENCH_REG_LIMIT_VOLTAGE_V, 150.0f);
    set(FLUXBENCH_REG_LIMIT_ENERGY_J, 1000.0f);
    (void)fb_power_arm();
    set(FLUXBENCH_REG_ROTOR_ANGLE_RAD, 0.3f);
    set(FLUXBENCH_REG_CURRENT_D_A, 1.0f);
    set(FLUXBENCH_REG_CURRENT_Q_A, -1.0f);
    set(FLUXBENCH_REG_SETTLE_S, 0.1f);
    set(FLUXBENCH_REG_DURATION_S, 0.1f);
    set(FLUXBENCH_REG_SWEPT_AXIS, 2.0f);
    set(FLUXBENCH_REG_AMPLITUDE_A, 1.5f);
    set(FLUXBENCH_REG_PERIOD_S, 0.1f);
    set(FLUXBENCH_REG_PERIODS, 2.0f);
    set(FLUXBENCH_REG_AMPLITUDE_V, 50.0f);
    set(FLUXBENCH_REG_FREQUENCY_HZ, 500.0f);
    set(FLUXBENCH_REG_ROTATION_HZ, 10.0f);
    set(FLUXBENCH_REG_RIPPLE_CURVATURE, 1.0f);
    run("hold", 1.0f, 31.0f, 0.0f, 0.0f, 0.0f);
    run("trapezoid", 2.0f, 31.0f, 0.0f, 0.0f, 0.0f);
    run("injection", 3.0f, 31.0f, 0.0f, 0.0f, 0.0f);
    run("injection-demodulated", 3.0f, 0.0f, 0.0f, 1.0f, 0.0f);
    run("injection-both", 3.0f, 31.0f, 0.0f, 1.0f, 0.0f);
    run("sine-both", 3.0f, 31.0f, 0.0f, 1.0f, 1.0f);
    run("sine-all-f32-both", 3.0f, 255.0f, 1.0f, 1.0f, 1.0f);
    run("gates-off", 0.0f, 31.0f, 0.0f, 0.0f, 0.0f);
    say("end\n");
    for (;;) {
    }
}

__attribute__((section(".vectors"), used)) static const struct {
    uint32_t *stack;
    void (*handlers[15])(void);
} vectors = {stack_top, {reset}};
