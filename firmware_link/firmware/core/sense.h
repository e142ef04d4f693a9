/* Sense: samples of the accelerometer from an interrupt to the frames of a stream that ends with its lease.
 *
 * The interrupt puts records, the main loop takes them, nothing is locked: only the interrupt writes `put`, `number` and
 * `lost`, only the main loop `taken` and `is_on`. Records are volatile like the indices, so that a compiler keeps the order
 * in which both are written and read. What finds no room is lost and counted; the numbers show the gap.
 */
#ifndef TACTABLE_SENSE_H
#define TACTABLE_SENSE_H

#include <stdbool.h>
#include <stdint.h>

#include "limits.h"

/* A power of two, so that the free-running indices may wrap; 20 ms at 3.2 kHz. */
#define SENSE_RECORDS 64u
/* Samples of the synthesis that the delay of a sensor may go back, a power of two; 1.3 ms at 48 kHz. */
#define SENSE_HISTORY 64u

struct sense_record {
    uint32_t number;           /* of the samples of the accelerometer since boot */
    uint32_t synthesis_sample; /* that the actuators stood at */
    int16_t acceleration;
    int16_t displacements[TACTABLE_ACTUATORS];
};

struct sense {
    volatile struct sense_record records[SENSE_RECORDS];
    int16_t history[SENSE_HISTORY][TACTABLE_ACTUATORS]; /* the last displacements */
    volatile uint32_t put;
    volatile uint32_t taken;
    volatile bool is_on;
    uint32_t number;
    volatile uint32_t lost;
    uint64_t end_us; /* NEVER_US while it is off */
    uint16_t frame;
    uint8_t number_of_actuators;
};

void sense_start(struct sense *sense, uint8_t number_of_actuators);

/* Interrupt: remembers the displacements of a sample of the synthesis. */
void sense_remember(struct sense *sense, uint32_t synthesis_sample, const int16_t *displacements);

/* Interrupt: the displacements of a sample of the synthesis that was remembered. */
const int16_t *sense_recall(const struct sense *sense, uint32_t synthesis_sample);

/* Interrupt: takes a sample of the accelerometer in counts, with the displacements that belong to it. */
void sense_take(struct sense *sense, int16_t acceleration, const int16_t *displacements, uint32_t synthesis_sample);

/* Number of records that wait. */
uint32_t sense_waiting(const struct sense *sense);

/* Number of the records that wait, at most `most`, which follow each other without a gap: a frame numbers its first. */
uint32_t sense_run(const struct sense *sense, uint32_t most);

/* The record that waits behind `index` others. */
const volatile struct sense_record *sense_waiting_at(const struct sense *sense, uint32_t index);

/* Forgets the first records that wait. */
void sense_drop(struct sense *sense, uint32_t records);

#endif
