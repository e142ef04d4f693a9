/* Tones: targets of the actuators to oscillators that run on, with amplitudes in straight lines.
 *
 * A channel has two oscillators: the one that it plays, and, during a crossfade, the one that it played before. The
 * amplitudes of all channels go along one w from 0 to 1, in the shortest time in which no channel's amplitudes together
 * move faster than the slew. So a change of drive is (1 - w) of the old and w of the new one, and what both leave quiet
 * stays quiet.
 *
 * Two cases differ. From silence each channel rises at the slew, and to silence each one falls at the slew, the two
 * amplitudes of a crossfade in proportion. A target that comes during a crossfade waits until it has ended.
 *
 * Written phases count from when they came, for all channels together. Where a channel sounds already, one angle is
 * added to all of them, so that of the channels that sound the loudest one to come goes on in phase: how the channels
 * stand to each other is kept, and drives that differ a little are displacements that differ a little.
 *
 * An oscillator is a 32-bit phase that wraps with the turn, so its frequency is exact to half of rate/2^32: 5.6 uHz at
 * 48 kHz. All channels step together; two of one frequency never part.
 */
#ifndef TACTABLE_TONES_H
#define TACTABLE_TONES_H

#include <stdbool.h>
#include <stdint.h>

#include "limits.h"

/* Full scale of amplitudes and gains: the word 65535, times 2^15. */
#define TONES_FULL_SCALE (65535 * 32768)
#define TONES_WORD_SCALE 32768

struct oscillator {
    uint32_t phase;
    uint32_t increment; /* each sample */
};

/* Target of one actuator from the next sample on, in words. */
struct tones_target {
    uint16_t frequency;
    uint16_t amplitude;
    uint16_t phase;
    bool writes_phase;
};

/* As `w` goes from 0 to 1, `amplitude` goes to `goal`, and `fading` to 0. */
struct tones_channel {
    struct oscillator oscillator;
    struct oscillator faded;
    struct oscillator written; /* runs already; the next transition begins to play it */
    bool is_written;
    int32_t amplitude;
    int32_t goal;
    int32_t fading;
    int32_t target;
    uint32_t w;
    uint32_t step; /* of w, each sample */
};

struct tones {
    struct tones_channel channels[TACTABLE_ACTUATORS];
    uint32_t rate_hz;
    uint32_t frequency_resolution_uhz;
    int32_t slew; /* each sample */
    uint8_t number_of_actuators;
    bool is_crossfading;
    bool is_waiting; /* the targets have not been begun */
};

void tones_start(
    struct tones *tones, uint8_t number_of_actuators, uint32_t rate_hz, uint32_t frequency_resolution_uhz);

/* Sets the slew limit of every amplitude, in full scale a second; only silence, or a fall to it, may be under way. */
void tones_slew(struct tones *tones, uint16_t slew_per_s);

/* Takes the targets of all actuators at one instant; a phase that is written is that of the next sample. */
void tones_aim(struct tones *tones, const struct tones_target *targets);

/* Displacement of full scale amplitude, 2^16 to one step of the output. */
int64_t tones_displacement(uint32_t phase, int32_t amplitude);

/* The displacements of one sample, 2^16 to one step of the output. */
void tones_sample(struct tones *tones, int64_t *displacements);

/* Amplitude of one channel's oscillators together, TONES_FULL_SCALE = 1. */
int32_t tones_amplitude(const struct tones_channel *channel);

/* Whether all amplitudes are 0. */
bool tones_are_silent(const struct tones *tones);

#endif
