#include "sense.h"

#include <string.h>

#include "device_time.h"

void sense_start(struct sense *sense, uint8_t number_of_actuators)
{
    sense->end_us = NEVER_US;
    sense->number_of_actuators = number_of_actuators;
}

void sense_remember(struct sense *sense, uint32_t synthesis_sample, const int16_t *displacements)
{
    memcpy(
        sense->history[synthesis_sample % SENSE_HISTORY], displacements, sense->number_of_actuators * sizeof *displacements);
}

const int16_t *sense_recall(const struct sense *sense, uint32_t synthesis_sample)
{
    return sense->history[synthesis_sample % SENSE_HISTORY];
}

void sense_take(struct sense *sense, int16_t acceleration, const int16_t *displacements, uint32_t synthesis_sample)
{
    const uint32_t number = sense->number++;
    if (!sense->is_on) {
        return;
    }
    if (sense_waiting(sense) == SENSE_RECORDS) {
        sense->lost++;
        return;
    }
    volatile struct sense_record *record = &sense->records[sense->put % SENSE_RECORDS];
    record->number = number;
    record->synthesis_sample = synthesis_sample;
    record->acceleration = acceleration;
    for (uint8_t i = 0; i < sense->number_of_actuators; i++) {
        record->displacements[i] = displacements[i];
    }
    sense->put++;
}

uint32_t sense_waiting(const struct sense *sense)
{
    return sense->put - sense->taken;
}

uint32_t sense_run(const struct sense *sense, uint32_t most)
{
    const uint32_t waiting = sense_waiting(sense), end = waiting < most ? waiting : most;
    uint32_t run = 0;
    while (run < end && sense_waiting_at(sense, run)->number == sense_waiting_at(sense, 0)->number + run) {
        run++;
    }
    return run;
}

const volatile struct sense_record *sense_waiting_at(const struct sense *sense, uint32_t index)
{
    return &sense->records[(sense->taken + index) % SENSE_RECORDS];
}

void sense_drop(struct sense *sense, uint32_t records)
{
    sense->taken += records;
}
