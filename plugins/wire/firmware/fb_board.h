/* What a board gives: fill in these functions and `fb_facts`, call fb_init() once, fb_sample() in the interrupt of every
   sampling instant, and fb_poll() from the main loop. Sizes are in the board's own fb_config.h. */

#ifndef FB_BOARD_H
#define FB_BOARD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "fb_config.h"

/* What the drive is and bears. SI units, peak values. */
struct fb_facts {
    float sampling_hz;           /* fb_sample() is called so often; the PWM has the same frequency or a multiple */
    float pwm_hz;
    float dc_bus_v;              /* nominal */
    float voltage_delay_samples; /* from the sampling instant to the middle of what the new duties do, less a half */
    float max_current_a;         /* longest vector that a host may ask for */
    float max_voltage_v;
    float sensor_span_a;         /* a phase reading beyond it is a broken sensor */
    float trip_ratio;            /* overcurrent over the host's limit; 1.25 at most */
    float overload_s;            /* most of the time integral of (i / rated)^2 - 1 */
    float watchdog_s;
    float longest_program_s;
    float hottest_c;             /* of what fb_board_temperature_c() reads */
    bool has_third_sensor;       /* else i_c of a reading is not looked at */
    bool has_thermometer;
    bool has_brake;
    bool has_interlocks;         /* named in the description's line `interlocks: door, cover`, at most eight */
    float resistance_ohm, l_d_h, l_q_h, rated_a; /* tune the control until a host tells better */
    const char *description;     /* lines `name: ...`, `motor: ...`, `firmware: ...`, `serial: ...`, `interlocks: ...` */
};
extern const struct fb_facts fb_facts;

/* One sampling instant. */
struct fb_reading {
    float i_a, i_b, i_c; /* A, positive into the motor */
    float v_dc;          /* V */
};

/* In the sampling interrupt. */
void fb_board_read(struct fb_reading *reading);
void fb_board_duties(float a, float b, float c); /* of the upper switches, 0 to 1; with the next update of the PWM */
void fb_board_gates(bool on);                    /* off opens all six at once */
bool fb_board_gate_fault(void);                  /* whether the gate driver says that it has tripped */

/* Anywhere. */
uint32_t fb_board_time_us(void); /* since power-up, wraps */
void fb_board_lock(void);        /* holds the sampling interrupt off, for the copy of a few words */
void fb_board_unlock(void);

/* In the main loop. */
float fb_board_temperature_c(void); /* where has_thermometer */
void fb_board_brake(bool engaged);  /* where has_brake */
uint8_t fb_board_interlocks(void);  /* where has_interlocks: a bit for each that is open, the first name's the lowest */

#if FB_LINK_CAN
struct fb_frame;
bool fb_board_can_receive(struct fb_frame *frame); /* false: nothing there */
bool fb_board_can_send(const struct fb_frame *frame); /* false: no mailbox is free */
#else
size_t fb_board_receive(uint8_t *octets, size_t most);          /* how many came; never waits */
size_t fb_board_send(const uint8_t *octets, size_t count);      /* how many were taken; never waits */
#endif

/* What the firmware gives the board. */
void fb_init(void);
void fb_sample(void);
void fb_poll(void);

#endif
