/* Oscillator targets: clamps, held frequencies and phase writes.
 *
 * A channel with amplitude 0 keeps its frequency, so that it fades out as it sounded. A phase write sets all sounding
 * channels at one instant; when their frequencies and phases run already as one earlier write set them, it changes
 * nothing. So every renewal of a drive may carry the write, and the loss of a frame loses no phase.
 */
#ifndef TACTABLE_CHANNELS_H
#define TACTABLE_CHANNELS_H

#include <stdbool.h>
#include <stdint.h>

#include "limits.h"
#include "tactable_protocol.h"

/* One actuator's oscillator, in words. */
struct channel {
    uint16_t frequency;
    uint16_t amplitude;
    uint16_t limit;
    uint32_t write; /* number of the phase write that still holds; 0: none */
    uint16_t written_frequency;
    uint16_t written_phase;
};

struct channels {
    struct channel channels[TACTABLE_ACTUATORS];
    uint16_t limits_to_come[TACTABLE_ACTUATORS];
    uint32_t writes;
    uint16_t frequency_minimum;
    uint16_t frequency_maximum;
    uint8_t number_of_actuators;
};

void channels_start(struct channels *channels, uint8_t number_of_actuators, uint16_t minimum, uint16_t maximum);

/* Whether any amplitude is set above zero. */
bool channels_are_driving(const struct channels *channels);

/* Puts the limits of the last ARM into force. */
void channels_take_limits(struct channels *channels);

/* What a SET changed: nothing, frequencies or amplitudes, or the phases of the sounding channels too. */
enum channels_change { CHANNELS_UNCHANGED, CHANNELS_CHANGED, CHANNELS_WRITTEN };

/* Takes the drive in the body of a SET. */
enum channels_change channels_apply(struct channels *channels, const uint8_t *set_body, bool writes_phase);

/* Sets every amplitude to zero. */
void channels_silence(struct channels *channels);

#endif
