/* Voice: one click as it sounds, resampled to the synthesis rate by linear interpolation. */
#ifndef TACTABLE_VOICE_H
#define TACTABLE_VOICE_H

#include <stdbool.h>
#include <stdint.h>

#include "click.h"
#include "limits.h"

struct voice {
    struct click click;
    uint64_t position;  /* in samples, times 2^32 */
    uint64_t increment; /* of the position, each sample of the synthesis */
    int32_t gain;       /* TONES_FULL_SCALE = 1 */
    bool is_sounding;
    bool is_fading;
    bool is_frozen; /* holds its displacement, since its basis may be gone */
    int32_t frozen[TACTABLE_ACTUATORS];
};

/* Starts a click whose bounds are set. */
void voice_play(
    struct voice *voice, const struct click *click, int32_t gain, uint32_t synthesis_rate_hz, uint8_t number_of_actuators);

/* Holds its present displacement, so that the basis may change, and fades. */
void voice_freeze(struct voice *voice, uint8_t number_of_actuators);

/* Adds the displacement of every actuator to what sounds with it, 2^16 to one step of the output. */
void voice_add(const struct voice *voice, int64_t *displacements, uint8_t number_of_actuators);

/* Advances by one sample of the synthesis; a voice that fades gets quieter by `slew`. */
void voice_advance(struct voice *voice, int32_t slew, uint8_t number_of_actuators);

#endif
