#include "electrode.h"

#define GREATEST_VOLTAGE 65535u
#define FULL_SCALE 32767
#define MID_SCALE 32768

/* The nearest whole number to a square root, bit by bit: 16 rounds of shifts and sums, on any core. */
static uint32_t square_root(uint32_t square)
{
    uint32_t root = 0, rest = square;
    for (uint32_t bit = 1u << 30; bit != 0; bit >>= 2) {
        if (rest >= root + bit) {
            rest -= root + bit;
            root = (root >> 1) + bit;
        } else {
            root >>= 1;
        }
    }
    return rest > root ? root + 1 : root;
}

int16_t electrode_output(uint16_t bias, int16_t displacement)
{
    /* The force goes as the square of the voltage. It may rise to that of the greatest voltage and fall to none; the
     * smaller of the two distances from rest is full scale, so that both ways are alike. */
    const uint32_t at_rest = (uint32_t)bias * bias;
    const uint32_t above = GREATEST_VOLTAGE * GREATEST_VOLTAGE - at_rest;
    const int64_t swing = at_rest < above ? at_rest : above;
    const int32_t moved = displacement < -FULL_SCALE ? -FULL_SCALE : displacement;
    const int64_t square = (int64_t)at_rest + swing * moved / FULL_SCALE;
    return (int16_t)((int32_t)square_root((uint32_t)square) - MID_SCALE);
}
