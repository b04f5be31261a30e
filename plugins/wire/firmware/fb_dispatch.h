/* What the host's messages ask for, and the answers. */

#ifndef FB_DISPATCH_H
#define FB_DISPATCH_H

#include "fb_frame.h"

void fb_dispatch(const struct fb_frame *frame);

#endif
