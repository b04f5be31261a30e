/* The registers: what they hold, and what may be written to them when. The table is fluxbench_registers.h. */

#ifndef FB_REGISTERS_H
#define FB_REGISTERS_H

#include <stdbool.h>
#include <stdint.h>

void fb_registers_init(void);

/* The value of a register that is there, by its FLUXBENCH_REG_ number; read after fb_registers_refresh(). */
float fb_register(uint8_t index);
bool fb_register_is_on(uint8_t index);
uint32_t fb_register_whole(uint8_t index);

/* From the drive's side, whatever the access. */
void fb_register_set(uint8_t index, float value);

bool fb_register_is_there(uint8_t index);

/* From the host's side; FLUXBENCH_ACK_OK, or why not. */
uint8_t fb_register_write(uint8_t index, float value, uint8_t state);

#endif
