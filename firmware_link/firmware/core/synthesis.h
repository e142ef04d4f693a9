/* Synthesis: targets and clicks to samples, within amplitude limits and slew. */
#ifndef TACTABLE_SYNTHESIS_H
#define TACTABLE_SYNTHESIS_H

#include <stdbool.h>
#include <stdint.h>

#include "limits.h"
#include "tones.h"
#include "voice.h"

/* One plays and one fades; a third, since a fade ends up to a sample later than the player knows. */
#define SYNTHESIS_VOICES 3u

struct synthesis {
    struct tones tones;
    struct voice voices[SYNTHESIS_VOICES];
    int32_t limits[TACTABLE_ACTUATORS]; /* of the sum, 2^16 to one step of the output */
    uint32_t rate_hz;
    uint8_t number_of_actuators;
    volatile uint32_t samples; /* since boot, for the watchdog */
};

void synthesis_start(
    struct synthesis *synthesis, uint8_t number_of_actuators, uint32_t rate_hz, uint32_t frequency_resolution_uhz);

/* Sets the greatest amplitude of one actuator, as a word. */
void synthesis_limit(struct synthesis *synthesis, uint8_t actuator, uint16_t amplitude);

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
