/* What fluxbench has to know of this ECU: fill in, all in SI units, currents and voltages as peaks of a vector. */

#ifndef FLUXBENCH_CONFIG_H
#define FLUXBENCH_CONFIG_H

#define FLUXBENCH_SAMPLING_HZ 10000.0f /* how often fluxbench_step() is called */
#define FLUXBENCH_PWM_HZ 10000.0f
#define FLUXBENCH_MAX_CURRENT_A 6.0f /* no run may ask for more */
#define FLUXBENCH_MAX_VOLTAGE_V 230.0f
#define FLUXBENCH_DC_BUS_V 400.0f      /* nominal */
#define FLUXBENCH_DELAY_SAMPLES 1.0f   /* from a sample to the duties that were computed from it */
#define FLUXBENCH_WATCHDOG_TICKS 3000u /* gates off when the beat counter stands still for so long; 0: no dead man */

#endif
