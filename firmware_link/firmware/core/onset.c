#include "onset.h"

#include "device_time.h"

bool onset_define(struct onset *onset, const struct tactable_shape *message)
{
    if (message->index >= TACTABLE_NUMBER_OF_SHAPES || message->steps > TACTABLE_SHAPE_STEPS) {
        return false;
    }
    const struct onset_shape shape = {
        {
            {message->until_1 * TACTABLE_SHAPE_TIME_US, message->gain_1},
            {message->until_2 * TACTABLE_SHAPE_TIME_US, message->gain_2},
            {message->until_3 * TACTABLE_SHAPE_TIME_US, message->gain_3},
        },
        message->steps,
    };
    for (uint8_t i = 1; i < shape.number_of_steps; i++) {
        if (shape.steps[i].until_us < shape.steps[i - 1u].until_us) {
            return false;
        }
    }
    onset->shapes[message->index] = shape;
    return true;
}

void onset_begin(struct onset *onset, uint8_t choice, uint64_t now_us)
{
    onset_end(onset);
    if (choice != 0) {
        onset->running = onset->shapes[choice - 1u];
        onset->since_us = now_us;
        onset_advance(onset, now_us);
    }
}

void onset_end(struct onset *onset)
{
    onset->running.number_of_steps = 0;
    onset->step = 0;
}

uint64_t onset_next_us(const struct onset *onset)
{
    if (onset->step >= onset->running.number_of_steps) {
        return NEVER_US;
    }
    return onset->since_us + onset->running.steps[onset->step].until_us;
}

void onset_advance(struct onset *onset, uint64_t now_us)
{
    while (onset_next_us(onset) <= now_us) {
        onset->step++;
    }
}

uint32_t onset_shaped(const struct onset *onset, uint16_t amplitude)
{
    if (onset->step >= onset->running.number_of_steps) {
        return amplitude;
    }
    return (uint32_t)amplitude * onset->running.steps[onset->step].gain / TACTABLE_SHAPE_FULL_GAIN;
}
