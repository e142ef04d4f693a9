/* Click: weights of a set of the basis to the samples of a waveform, one after the other. PROTOCOL.md defines them. */
#ifndef TACTABLE_CLICK_H
#define TACTABLE_CLICK_H

#include <stdint.h>

#include "basis.h"
#include "limits.h"
#include "tactable_protocol.h"

struct click {
    struct basis_set set;
    int16_t weights[TACTABLE_MAXIMUM_WEIGHTS];
    uint8_t fraction_bits;
    uint16_t at; /* index of the sample in `before` */
    int32_t before[TACTABLE_ACTUATORS];
    int32_t after[TACTABLE_ACTUATORS];
    int32_t limit[TACTABLE_ACTUATORS]; /* of the magnitude */
    int32_t step[TACTABLE_ACTUATORS];  /* of the change from one sample to the next */
};

/* Takes set and weights; the body of the PLAY has as many as the set has functions. */
void click_start(struct click *click, const struct basis_set *set, const uint8_t *play_body, uint8_t fraction_bits);

/* Sets the bounds of one actuator, from its amplitude limit, a word, and the highest frequency of the device. */
void click_limit(struct click *click, uint8_t actuator, uint16_t amplitude, uint32_t frequency_maximum_uhz);

/* Computes the sample behind the first, once all bounds are set. */
void click_begin(struct click *click, uint8_t number_of_actuators);

/* Goes on by one sample; `after` must not be the last. */
void click_next(struct click *click, uint8_t number_of_actuators);

#endif
