/* Device time: microseconds since boot. */
#ifndef TACTABLE_DEVICE_TIME_H
#define TACTABLE_DEVICE_TIME_H

#include <stdint.h>

#define US_PER_MS 1000u
#define US_PER_S 1000000u
#define NEVER_US UINT64_MAX

static inline uint64_t earlier_us(uint64_t one_us, uint64_t other_us)
{
    return one_us < other_us ? one_us : other_us;
}

/* A 32-bit counter of microseconds extended to 64 bits; it must be read at least once in 71 minutes, its period. */
struct wide_clock {
    uint64_t now_us;
};

static inline uint64_t wide_clock_read(struct wide_clock *clock, uint32_t counter_us)
{
    clock->now_us += (uint32_t)(counter_us - (uint32_t)clock->now_us);
    return clock->now_us;
}

#endif
