/* The pseudo-terminal's octets, for a serial line or for frames of a CAN bus written out in letters. */

#ifndef TERMINAL_H
#define TERMINAL_H

#include <stddef.h>
#include <stdint.h>

size_t terminal_receive(uint8_t *octets, size_t most);    /* how many came; never waits */
size_t terminal_send(const uint8_t *octets, size_t count); /* how many were taken; never waits */

#endif
