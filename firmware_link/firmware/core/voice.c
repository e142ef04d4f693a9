#include "voice.h"

#include "bytes.h"

/* Bits of the position between two samples, and of the displacement below one step. */
#define PLACE_BITS 16
#define DISPLACEMENT_BITS 8
/* Shift from 31 bits of gain and 8 of displacement to the 16 fraction bits of a sum. */
#define GAIN_SHIFT 23

static int32_t sample_at(const struct voice *voice, uint32_t index, uint8_t actuator, uint8_t number_of_actuators)
{
    return (int16_t)get_u16(voice->samples + 2u * (index * number_of_actuators + actuator));
}

/* Displacement between two samples, times 2^DISPLACEMENT_BITS; the position must be before the last sample. */
static int32_t displacement(const struct voice *voice, uint8_t actuator, uint8_t number_of_actuators)
{
    if (voice->is_frozen) {
        return voice->frozen[actuator];
    }
    const uint32_t index = (uint32_t)(voice->position >> 32);
    const int32_t place = (int32_t)((uint32_t)voice->position >> (32 - PLACE_BITS));
    const int32_t before = sample_at(voice, index, actuator, number_of_actuators);
    const int32_t after = sample_at(voice, index + 1u, actuator, number_of_actuators);
    const int64_t moved = (int64_t)(after - before) * place / (1 << (PLACE_BITS - DISPLACEMENT_BITS));
    return before * (1 << DISPLACEMENT_BITS) + (int32_t)moved;
}

void voice_play(struct voice *voice, const struct waveform *waveform, int32_t gain, uint32_t synthesis_rate_hz)
{
    *voice = (struct voice){
        .samples = waveform->samples,
        .increment = ((uint64_t)waveform->sample_rate_hz << 32) / synthesis_rate_hz,
        .gain = gain,
        .last = (uint16_t)(waveform->number_of_samples - 1u),
        .is_sounding = true,
    };
}

void voice_freeze(struct voice *voice, uint8_t number_of_actuators)
{
    if (!voice->is_sounding || voice->is_frozen) {
        return;
    }
    for (uint8_t i = 0; i < number_of_actuators; i++) {
        voice->frozen[i] = displacement(voice, i, number_of_actuators);
    }
    voice->is_frozen = true;
}

void voice_add(const struct voice *voice, int64_t *displacements, uint8_t number_of_actuators)
{
    for (uint8_t i = 0; i < number_of_actuators; i++) {
        /* The shift divides by 65536 where the gain has 65535: an error of less than half a step of the output. */
        displacements[i] += (int64_t)displacement(voice, i, number_of_actuators) * voice->gain / (1 << GAIN_SHIFT);
    }
}

void voice_advance(struct voice *voice, int32_t slew)
{
    voice->position += voice->increment;
    if (voice->is_fading) {
        voice->gain = voice->gain > slew ? voice->gain - slew : 0;
    }
    const bool is_over = !voice->is_frozen && voice->position >> 32 >= voice->last;
    if (is_over || voice->gain == 0) {
        voice->is_sounding = false;
    }
}
