/* A wall clock that jumps: after CLOCK_JUMP_AFTER readings it is CLOCK_JUMP_S seconds off, and back after as many more.
   Preloaded. Monotonic clocks and the file system's time stamps stay true. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <sys/time.h>
#include <time.h>

static long offset(void) {
    static long after = -1, jump = 0, readings = 0;
    if (after < 0) {
        const char *text = getenv("CLOCK_JUMP_AFTER");
        after = text ? atol(text) : 0;
        text = getenv("CLOCK_JUMP_S");
        jump = text ? atol(text) : 0;
    }
    long now = __sync_add_and_fetch(&readings, 1);
    return after > 0 && now > after && now <= 2 * after ? jump : 0;
}

int clock_gettime(clockid_t clock, struct timespec *now) {
    static int (*true_call)(clockid_t, struct timespec *);
    if (!true_call) true_call = (int (*)(clockid_t, struct timespec *))dlsym(RTLD_NEXT, "clock_gettime");
    int result = true_call(clock, now);
    if (result == 0 && clock == CLOCK_REALTIME) now->tv_sec += offset();
    return result;
}

time_t time(time_t *out) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (out) *out = now.tv_sec;
    return now.tv_sec;
}

int gettimeofday(struct timeval *now, void *zone) {
    struct timespec exact;
    int result = clock_gettime(CLOCK_REALTIME, &exact);
    now->tv_sec = exact.tv_sec;
    now->tv_usec = exact.tv_nsec / 1000;
    return result;
}
