/* A small XCP slave: one master, one dynamic DAQ list of one ODT, one event. Memory is the variable `fluxbench` alone. */

#ifndef XCP_H
#define XCP_H

#include <stddef.h>
#include <stdint.h>

#define XCP_MOST_CTO 64u
#define XCP_MOST_DTO 256u

/* Answers a command; returns the octets of the answer. */
size_t xcp_answer(const uint8_t *command, size_t octets, uint8_t *answer);

/* What the event sends now; 0 where nothing is measured. */
size_t xcp_event(uint8_t *message);

void xcp_forget(void);

#endif
