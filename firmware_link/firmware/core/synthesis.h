/* Synthesis: targets to samples, by phase-continuous oscillators with slew-limited amplitudes, and clicks over them.
 *
 * An oscillator is a 32-bit phase that wraps with the turn, so its frequency is exact to half of rate/2^32: 5.6 uHz at
 * 48 kHz. All channels step together; two of one frequency never part.
 */
#ifndef TACTABLE_SYNTHESIS_H
#define TACTABLE_SYNTHESIS_H

#include <stdbool.h>
#include <stdint.h>

#include "limits.h"
#include "voice.h"

/* Full scale of amplitudes and gains: the word 65535, times 2^15. */
#define SYNTHESIS_FULL_SCALE (65535 * 32768)
#define SYNTHESIS_WORD_SCALE 32768
/* One plays and one fades; a third, since a fade ends up to a sample later than the player knows. */
#define SYNTHESIS_VOICES 3u

struct oscillator {
    uint32_t phase;
    uint32_t increment; /* each sample */
};

/* Target of one actuator from the next sample on, in words. */
struct synthesis_target {
    uint16_t frequency;
    uint16_t amplitude;
    uint16_t phase;
    bool writes_phase;
};

struct synthesis_channel {
    struct oscillator oscillator;
    struct oscillator next; /* runs already, and takes over once the amplitude is 0 */
    bool has_next;
    int32_t amplitude;
    int32_t target;
    int32_t limit; /* of the sum, 2^16 to one step of the output */
};

struct synthesis {
    struct synthesis_channel channels[TACTABLE_ACTUATORS];
    struct voice voices[SYNTHESIS_VOICES];
    uint32_t rate_hz;
    uint32_t frequency_resolution_uhz;
    int32_t slew; /* each sample */
    uint8_t number_of_actuators;
    volatile uint32_t samples; /* since boot, for the watchdog */
};

void synthesis_start(
    struct synthesis *synthesis, uint8_t number_of_actuators, uint32_t rate_hz, uint32_t frequency_resolution_uhz);

/* Sets the slew limit of every amplitude, in full scale a second. */
void synthesis_slew(struct synthesis *synthesis, uint16_t slew_per_s);

/* Sets the greatest amplitude of one actuator, as a word. */
void synthesis_limit(struct synthesis *synthesis, uint8_t actuator, uint16_t amplitude);

/* Sets the target of one actuator. Without a phase write the oscillator keeps its phase; a written phase is that of the
 * next sample. A channel that sounds fades out as it was, then fades in with the new oscillator, which has run on. */
void synthesis_aim(struct synthesis *synthesis, uint8_t actuator, const struct synthesis_target *target);

/* Starts a click, whose bounds are set, over what sounds; `amplitude` is a word. */
void synthesis_play(struct synthesis *synthesis, const struct click *click, uint16_t amplitude);

/* Lets all clicks fade. */
void synthesis_fade_clicks(struct synthesis *synthesis);

/* Prepares these bytes for a change: a click that reads them holds its displacement instead, and fades. */
void synthesis_release(struct synthesis *synthesis, const uint8_t *first, const uint8_t *end);

/* Whether all is silent. */
bool synthesis_is_silent(const struct synthesis *synthesis);

/* The displacements of one sample, 32767 = full scale. */
void synthesis_sample(struct synthesis *synthesis, int16_t *displacements);

#endif
