/* Sizes of the board mps2-an386, as QEMU emulates it: a Cortex-M4 with a motor in software. */

#ifndef FB_CONFIG_H
#define FB_CONFIG_H

#define FB_LINK_CAN 0
#define FB_LINK_CAN_FD 0
#define FB_NODE 0u
#define FB_CAPTURE_WORDS 524288u /* 1 MB of the board's 16: an STM32G474 has room for 32 kB */
#define FB_CAPTURE_MEMORY __attribute__((section(".captures")))
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
