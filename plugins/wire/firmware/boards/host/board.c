/* The firmware as a process: a motor in place of the bridge, a pseudo-terminal in place of the UART, or of an adapter on a
   CAN bus (slcan.c).

       ./fluxbench-host LINK [SPEED [LAMP [SWITCHES]]]

   LINK becomes a symbolic link to the terminal; SPEED is the simulated seconds a second, 1 by default. The first octet of
   the file LAMP is 1 while the gates are on. The first octet of the file SWITCHES is the digit whose bits are the interlock
   inputs that are open: 1 the door, 2 the cover; built with EXTRA=-DFB_HAS_INTERLOCKS=1. */

#ifndef _GNU_SOURCE
#define _GNU_SOURCE
#endif
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "fb_board.h"
#include "fb_config.h"
#include "motor.h"
#include "terminal.h"

#define SAMPLING_HZ 10000.0f
#define FORGIVEN_S 0.25 /* what a process that was stopped missed is caught up with as far as this */
#define ATTENDED_S 2e-3 /* at most, before the link is looked at again */
#define MOST_OCTETS 1100u

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
    .description = "name: fluxbench firmware on the host\nmotor: 400 W test PMSM\nfirmware: reference\n"
                   "serial: 1\nclock: simulated" FB_INTERLOCKS_LINE,
    .has_interlocks = FB_HAS_INTERLOCKS != 0,
};

static struct motor motor;
static int master = -1;
static int lamp = -1;
static int switches = -1;
static bool is_connected;
static volatile sig_atomic_t is_ending;

/* The sampling interrupt is a call from the main loop here: nothing needs to be held off. */

void fb_board_lock(void)
{
}

void fb_board_unlock(void)
{
}

static double now_s(void)
{
    struct timespec now;

    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

uint32_t fb_board_time_us(void)
{
    struct timespec now;

    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint32_t)((uint64_t)now.tv_sec * 1000000u + (uint64_t)now.tv_nsec / 1000u);
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
    const char shown = on ? '1' : '0';

    if (on != motor.gates && lamp >= 0) {
        (void)!pwrite(lamp, &shown, 1u, 0);
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
    char digit = '0';

    return switches >= 0 && pread(switches, &digit, 1u, 0) == 1 && digit >= '0' ? (uint8_t)((digit - '0') & 3) : (uint8_t)0u;
}

/* The terminal */

static void look(int timeout_ms)
{
    struct pollfd terminal = {.fd = master, .events = POLLIN};
    const int ready = poll(&terminal, 1, timeout_ms);

    is_connected = ready == 0 || (ready > 0 && (terminal.revents & POLLHUP) == 0);
    if (!is_connected) {
        (void)tcflush(master, TCOFLUSH);
        (void)poll(NULL, 0, timeout_ms < 2 ? timeout_ms : 2);
    }
}

size_t terminal_receive(uint8_t *octets, size_t most)
{
    unsigned char bytes[MOST_OCTETS];
    const ssize_t count = read(master, bytes, most < sizeof(bytes) ? most : sizeof(bytes));

    for (ssize_t k = 0; k < count; k++) {
        octets[k] = bytes[k];
    }
    return count > 0 ? (size_t)count : 0u;
}

size_t terminal_send(const uint8_t *octets, size_t count)
{
    unsigned char bytes[MOST_OCTETS];
    const size_t size = count < sizeof(bytes) ? count : sizeof(bytes);
    ssize_t sent;

    for (size_t k = 0; k < size; k++) {
        bytes[k] = (unsigned char)octets[k];
    }
    sent = is_connected ? write(master, bytes, size) : (ssize_t)size; /* nobody is there: a line loses it */
    return sent > 0 ? (size_t)sent : 0u;
}

#if !FB_LINK_CAN
size_t fb_board_receive(uint8_t *octets, size_t most)
{
    return terminal_receive(octets, most);
}

size_t fb_board_send(const uint8_t *octets, size_t count)
{
    return terminal_send(octets, count);
}
#endif

static bool open_terminal(const char *path)
{
    struct termios raw;
    const char *name;
    int slave;

    master = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
    if (master < 0 || grantpt(master) != 0 || unlockpt(master) != 0) {
        return false;
    }
    name = ptsname(master);
    slave = open(name, O_RDWR | O_NOCTTY);
    if (slave < 0 || tcgetattr(slave, &raw) != 0) {
        return false;
    }
    cfmakeraw(&raw);
    (void)tcsetattr(slave, TCSANOW, &raw);
    (void)close(slave);
    (void)unlink(path);
    return symlink(name, path) == 0;
}

/* Time */

/* A microcontroller shares its time with nobody; not every system allows it. */
static void ask_for_priority(void)
{
    const struct sched_param first = {.sched_priority = 1};

    (void)sched_setscheduler(0, SCHED_RR, &first);
}

static void sample(void)
{
    fb_sample();
    motor_pass(&motor, 1.0f / SAMPLING_HZ);
}

static void end(int number)
{
    (void)number;
    is_ending = 1;
}

int main(int argc, char **argv)
{
    const double speed = argc > 2 ? atof(argv[2]) : 1.0;
    const double rate = speed * (double)SAMPLING_HZ;
    double due_s;

    if (argc < 2 || !(speed > 0.0)) {
        (void)fprintf(stderr, "usage: %s LINK [SPEED [LAMP [SWITCHES]]]\n", argv[0]);
        return 2;
    }
    if (argc > 3) {
        lamp = open(argv[3], O_RDWR | O_CREAT | O_TRUNC, 0600);
        (void)!pwrite(lamp, "0", 1u, 0);
    }
    if (argc > 4) {
        switches = open(argv[4], O_RDWR | O_CREAT, 0600);
    }
    if (!open_terminal(argv[1])) {
        (void)fprintf(stderr, "%s: cannot be made a terminal\n", argv[1]);
        return 2;
    }
    (void)signal(SIGINT, end);
    (void)signal(SIGTERM, end);
    ask_for_priority();
    motor_init(&motor);
    fb_init();
    due_s = now_s();
    while (is_ending == 0) {
        const double begun_s = now_s();

        if (begun_s - due_s > FORGIVEN_S) {
            due_s = begun_s - FORGIVEN_S;
        }
        while (due_s <= begun_s && now_s() - begun_s < ATTENDED_S) {
            sample();
            due_s += 1.0 / rate;
        }
        look(due_s > now_s() ? 1 : 0);
        fb_poll();
    }
    (void)unlink(argv[1]);
    return 0;
}
