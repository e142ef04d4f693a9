#include "voice.h"

/* Bits of the position between two samples, and of the displacement below one step. */
#define PLACE_BITS 16
#define DISPLACEMENT_BITS 8
/* Shift from 31 bits of gain and 8 of displacement to the 16 fraction bits of a sum. */
#define GAIN_SHIFT 23

/* Displacement between two samples, times 2^DISPLACEMENT_BITS; the position must be before the last sample. */
static int32_t displacement(const struct voice *voice, uint8_t actuator)
{
    if (voice->is_frozen) {
        return voice->frozen[actuator];
    }
    const int32_t place = (int32_t)((uint32_t)voice->position >> (32 - PLACE_BITS));
    const int32_t before = voice->click.before[actuator];
    const int32_t after = voice->click.after[actuator];
    const int64_t moved = (int64_t)(after - before) * place / (1 << (PLACE_BITS - DISPLACEMENT_BITS));
    return before * (1 << DISPLACEMENT_BITS) + (int32_t)moved;
}

void voice_play(
    struct voice *voice, const struct click *click, int32_t gain, uint32_t synthesis_rate_hz, uint8_t number_of_actuators)
{
    voice->click = *click;
    voice->position = 0;
    voice->increment = ((uint64_t)click->set.sample_rate_hz << 32) / synthesis_rate_hz;
    voice->gain = gain;
    voice->is_sounding = true;
    voice->is_fading = voice->is_frozen = false;
    click_begin(&voice->click, number_of_actuators);
}

void voice_freeze(struct voice *voice, uint8_t number_of_actuators)
{
    if (!voice->is_sounding || voice->is_frozen) {
        return;
    }
    for (uint8_t i = 0; i < number_of_actuators; i++) {
        voice->frozen[i] = displacement(voice, i);
    }
    voice->is_frozen = true;
}

void voice_add(const struct voice *voice, int64_t *displacements, uint8_t number_of_actuators)
{
    for (uint8_t i = 0; i < number_of_actuators; i++) {
        /* The shift divides by 65536 where the gain has 65535: an error of less than half a step of the output. */
        displacements[i] += (int64_t)displacement(voice, i) * voice->gain / (1 << GAIN_SHIFT);
    }
}

void voice_advance(struct voice *voice, int32_t slew, uint8_t number_of_actuators)
{
    voice->position += voice->increment;
    if (voice->is_fading) {
        voice->gain = voice->gain > slew ? voice->gain - slew : 0;
    }
    const uint32_t index = (uint32_t)(voice->position >> 32);
    const bool is_over = !voice->is_frozen && index >= voice->click.set.number_of_samples - 1u;
    if (is_over || voice->gain == 0) {
        voice->is_sounding = false;
        return;
    }
    /* A basis of a higher rate than the synthesis passes several samples at once: each bounds the next. */
    while (!voice->is_frozen && voice->click.at < index) {
        click_next(&voice->click, number_of_actuators);
    }
}
