/* Sizes of the host board: a process with a motor, behind a pseudo-terminal. */

#ifndef FB_CONFIG_H
#define FB_CONFIG_H

#ifndef FB_LINK_CAN
#define FB_LINK_CAN 0
#endif
#define FB_LINK_CAN_FD 0
#define FB_NODE 0u
#ifndef FB_CAPTURE_WORDS
#define FB_CAPTURE_WORDS 524288u /* 1 MB: ten seconds of five channels at 10 kS/s */
#endif
#define FB_CAPTURE_MEMORY
#define FB_RIPPLE_ROWS 4096u
#define FB_SERIAL_BLOCK_OCTETS 1020u
#ifndef FB_WATCHDOG_S
#define FB_WATCHDOG_S 0.2f
#endif
#ifndef FB_HAS_INTERLOCKS
#define FB_HAS_INTERLOCKS 0
#endif
#if FB_HAS_INTERLOCKS
#define FB_INTERLOCKS_LINE "\ninterlocks: door, cover"
#else
#define FB_INTERLOCKS_LINE ""
#endif

#endif
