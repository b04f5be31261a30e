/* The firmware on a Cortex-M4: Arm's mps2-an386 as QEMU emulates it. UART0 is the serial line, SysTick the sampling
   interrupt, and a motor in software stands where the bridge would be.

       qemu-system-arm -M mps2-an386 -nographic -monitor none -serial tcp:127.0.0.1:5025,server=on,wait=off \
           -kernel fluxbench-mps2_an386.elf

   A second -serial is a lamp, 1 when the gates go on and 0 when they go off, and, built with
   EXTRA=-DFB_HAS_INTERLOCKS=1, two interlock inputs: the digit that came last. */

#include "fb_board.h"
#include "motor.h"

#define SAMPLING_HZ 10000.0f
#define PERIOD_US 100u
#define TICK_US 500u      /* of SysTick: five periods at once, for an emulator is not as punctual as a timer */
#define FORGIVEN_US 250000u
#define MOST_PERIODS 20u  /* in one interrupt */
#define MOST_SENT 128u /* octets at once: QEMU's UART takes all there is, and the main loop's time with it */
#define CLOCK_HZ 25000000u

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define UART_DATA REGISTER(0x40004000u)
#define UART_STATE REGISTER(0x40004004u)
#define UART_CTRL REGISTER(0x40004008u)
#define UART_BAUDDIV REGISTER(0x40004010u)
#define SIDE_DATA REGISTER(0x40005000u) /* UART1 */
#define SIDE_STATE REGISTER(0x40005004u)
#define SIDE_CTRL REGISTER(0x40005008u)
#define SIDE_BAUDDIV REGISTER(0x40005010u)
#define UART_BOTH_WAYS 3u
#define UART_RX_INTERRUPT 8u
#define UART_INTSTATUS REGISTER(0x4000400Cu)
#define UART_TX_FULL 1u
#define UART_RX_FULL 2u
#define COUNTER_US REGISTER(0x40028018u)
#define PRESCALE REGISTER(0x4002801Cu)
#define PRESCALE_MHZ 25u
#define SYSTICK_CTRL REGISTER(0xE000E010u)
#define SYSTICK_LOAD REGISTER(0xE000E014u)
#define SYSTICK_NOW REGISTER(0xE000E018u)
#define TICK_CLOCKS (CLOCK_HZ / 1000000u * TICK_US)
#define NVIC_ENABLE REGISTER(0xE000E100u)
#define UART_RX_IRQ 0u
#define CPACR REGISTER(0xE000ED88u)
#define FPU_ON 0x00F00000u

const struct fb_facts fb_facts = {
    .sampling_hz = SAMPLING_HZ,
    .pwm_hz = SAMPLING_HZ,
    .dc_bus_v = MOTOR_BUS_V,
    .voltage_delay_samples = 1.0f,
    .max_current_a = 6.0f,
    .max_voltage_v = 230.0f,
    .sensor_span_a = 15.9f,
    .trip_ratio = 1.2f,
    .overload_s = 120.0f,
    .watchdog_s = FB_WATCHDOG_S,
    .longest_program_s = 3600.0f,
    .hottest_c = 120.0f,
    .resistance_ohm = 4.25f,
    .l_d_h = 0.04325f,
    .l_q_h = 0.06905f,
    .rated_a = 2.35f,
    .description = "name: fluxbench firmware on a Cortex-M4\nmotor: 400 W test PMSM\nfirmware: reference\n"
                   "serial: 1\nclock: simulated" FB_INTERLOCKS_LINE,
    .has_interlocks = FB_HAS_INTERLOCKS != 0,
};

static struct motor motor;
static uint32_t sampled_us;
static volatile bool has_polled;
static volatile uint32_t longest; /* clocks that fb_sample() took at most */

#define CAME 1024u
static volatile struct {
    uint8_t octets[CAME];
    uint32_t in, out;
} came;

void fb_board_lock(void)
{
    __asm volatile("cpsid i" ::: "memory");
}

void fb_board_unlock(void)
{
    __asm volatile("cpsie i" ::: "memory");
}

uint32_t fb_board_time_us(void)
{
    return COUNTER_US;
}

void fb_board_read(struct fb_reading *reading)
{
    motor_read(&motor, &reading->i_a, &reading->i_b);
    reading->i_c = 0.0f;
    reading->v_dc = MOTOR_BUS_V;
}

void fb_board_duties(float a, float b, float c)
{
    motor_set_duties(&motor, a, b, c);
}

void fb_board_gates(bool on)
{
    if (on != motor.gates) {
        SIDE_DATA = on ? '1' : '0';
    }
    motor.gates = on;
}

bool fb_board_gate_fault(void)
{
    return false;
}

float fb_board_temperature_c(void)
{
    return 25.0f;
}

void fb_board_brake(bool engaged)
{
    (void)engaged;
}

uint8_t fb_board_interlocks(void)
{
    static uint8_t open;

    if ((SIDE_STATE & UART_RX_FULL) != 0u) {
        open = (uint8_t)(SIDE_DATA & 3u);
    }
    return open;
}

/* The UART keeps one octet: its interrupt takes it away, and wakes the main loop. */
static void uart_rx(void)
{
    UART_INTSTATUS = 2u;
    while ((UART_STATE & UART_RX_FULL) != 0u) {
        const uint8_t octet = (uint8_t)UART_DATA;

        if (came.in - came.out < CAME) {
            came.octets[came.in % CAME] = octet;
            came.in++;
        }
    }
}

size_t fb_board_receive(uint8_t *octets, size_t most)
{
    size_t count = 0;

    while (count < most && came.out != came.in) {
        octets[count] = came.octets[came.out % CAME];
        came.out++;
        count++;
    }
    return count;
}

size_t fb_board_send(const uint8_t *octets, size_t count)
{
    size_t sent = 0;

    while (sent < count && sent < MOST_SENT && (UART_STATE & UART_TX_FULL) == 0u) {
        UART_DATA = octets[sent];
        sent++;
    }
    return sent;
}

/* As many sampling periods as have passed: a host that was busy hands the time over late. The main loop has a turn in
   between, or it would be kept from hearing the heartbeat while much is caught up with. */
static void systick(void)
{
    uint32_t behind_us = COUNTER_US - sampled_us;

    if (!has_polled) {
        return;
    }
    has_polled = false;

    if (behind_us > FORGIVEN_US) {
        sampled_us += behind_us - FORGIVEN_US;
        behind_us = FORGIVEN_US;
    }
    for (uint32_t k = 0; k < MOST_PERIODS && behind_us >= PERIOD_US; k++) {
        const uint32_t before = SYSTICK_NOW;
        uint32_t took;

        fb_sample();
        took = (before + TICK_CLOCKS - SYSTICK_NOW) % TICK_CLOCKS;
        longest = took > longest ? took : longest;
        motor_pass(&motor, 1.0f / SAMPLING_HZ);
        sampled_us += PERIOD_US;
        behind_us -= PERIOD_US;
    }
}

static void run(void)
{
    PRESCALE = PRESCALE_MHZ - 1u;
    UART_BAUDDIV = 16u;
    UART_CTRL = UART_BOTH_WAYS | UART_RX_INTERRUPT;
    NVIC_ENABLE = 1u << UART_RX_IRQ;
    SIDE_BAUDDIV = 16u;
    SIDE_CTRL = UART_BOTH_WAYS;
    motor_init(&motor);
    fb_init();
    sampled_us = COUNTER_US;
    SYSTICK_LOAD = TICK_CLOCKS - 1u;
    SYSTICK_CTRL = 7u; /* core clock, interrupt, on */
    for (;;) {
        fb_poll();
        has_polled = true;
        if (came.in == came.out) {
            __asm volatile("wfi");
        }
    }
}

/* From reset */

extern uint32_t data_begin[], data_end[], data_image[], bss_begin[], bss_end[], stack_top[];

void reset(void);

void reset(void)
{
    const uint32_t *from = data_image;

    CPACR |= FPU_ON;
    __asm volatile("dsb\n isb");
    for (uint32_t *to = data_begin; to < data_end; to++) {
        *to = *from;
        from++;
    }
    for (uint32_t *to = bss_begin; to < bss_end; to++) {
        *to = 0u;
    }
    run();
}

static void fault(void)
{
    motor.gates = false;
    for (;;) {
    }
}

__attribute__((section(".vectors"), used)) static const struct {
    uint32_t *stack;
    void (*handlers[16])(void);
} vectors = {
    stack_top,
    {reset, fault, fault, fault, fault, fault, 0, 0, 0, 0, fault, fault, 0, fault, systick, uart_rx},
};
