/* As on a machine whose char has 16 bits: an octet lies in an element of 16. */

#ifndef OCTETS_H
#define OCTETS_H

#include <stdint.h>

#define uint8_t uint16_t
#define int8_t int16_t

#endif
