/* Sizes for the fuzzer: small, so that memories fill. */

#ifndef FB_CONFIG_H
#define FB_CONFIG_H

#ifndef FB_LINK_CAN
#define FB_LINK_CAN 0
#endif
#define FB_LINK_CAN_FD 0
#define FB_NODE 0u
#define FB_CAPTURE_WORDS 301u
#define FB_CAPTURE_MEMORY
#define FB_RIPPLE_ROWS 7u
#define FB_SERIAL_BLOCK_OCTETS 60u

#endif
