/* How a drive begins: up to three steps, each a gain until a time; then the amplitude is full. */
#ifndef TACTABLE_ONSET_H
#define TACTABLE_ONSET_H

#include <stdbool.h>
#include <stdint.h>

#include "tactable_protocol.h"

struct onset_step {
    uint32_t until_us;
    uint16_t gain; /* 1/TACTABLE_SHAPE_FULL_GAIN */
};

struct onset_shape {
    struct onset_step steps[TACTABLE_SHAPE_STEPS];
    uint8_t number_of_steps;
};

struct onset {
    struct onset_shape shapes[TACTABLE_NUMBER_OF_SHAPES];
    struct onset_shape running;
    uint64_t since_us;
    uint8_t step;
};

/* Keeps a shape; false for one that is none. */
bool onset_define(struct onset *onset, const struct tactable_shape *message);

/* Begins the course that a SET chose: 0 none, k shape k - 1. */
void onset_begin(struct onset *onset, uint8_t choice, uint64_t now_us);

/* The drive is silent: no course runs. */
void onset_end(struct onset *onset);

/* When the gain changes next; NEVER_US without a course. */
uint64_t onset_next_us(const struct onset *onset);

/* Leaves behind the steps that are over. */
void onset_advance(struct onset *onset, uint64_t now_us);

/* What the gain makes of an amplitude, rounded down; may be more than full scale. */
uint32_t onset_shaped(const struct onset *onset, uint16_t amplitude);

#endif
