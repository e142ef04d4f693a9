#include "sine.h"

#include "sine_table.h"

#define HALF_TURN 0x80000000u
#define QUARTER_TURN 0x40000000u
/* A quarter has 30 bits: 8 choose the interval, 16 of the rest the place in it. */
#define INTERVAL_SHIFT 22
#define PLACE_SHIFT 6
#define PLACE_BITS 16
#define PLACE_MASK 0xffffu

static const int32_t quarter[SINE_INTERVALS + 1u] = {SINE_QUARTER};

int32_t sine_of(uint32_t phase)
{
    uint32_t within_half = phase & ~HALF_TURN;
    if (within_half > QUARTER_TURN) {
        within_half = HALF_TURN - within_half;
    }
    const uint32_t interval = within_half >> INTERVAL_SHIFT;
    const int64_t place = within_half >> PLACE_SHIFT & PLACE_MASK;
    int32_t sine = quarter[interval];
    if (place != 0) {
        sine += (int32_t)((quarter[interval + 1u] - sine) * place / (1 << PLACE_BITS));
    }
    return phase & HALF_TURN ? -sine : sine;
}
