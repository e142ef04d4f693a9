#include "synthesis.h"

#define QUARTER_TURN 0x40000000u
/* Displacements are summed with 2^16 to one step of the output. */
#define OUTPUT_STEP (1 << 16)

static int16_t output(int64_t displacement, int32_t limit)
{
    const int64_t clamped = displacement > limit ? limit : displacement < -limit ? -limit : displacement;
    return (int16_t)((clamped + (clamped < 0 ? -OUTPUT_STEP / 2 : OUTPUT_STEP / 2)) / OUTPUT_STEP);
}

void synthesis_start(
    struct synthesis *synthesis, uint8_t number_of_actuators, uint32_t rate_hz, uint32_t frequency_resolution_uhz)
{
    *synthesis = (struct synthesis){.number_of_actuators = number_of_actuators, .rate_hz = rate_hz};
    tones_start(&synthesis->tones, number_of_actuators, rate_hz, frequency_resolution_uhz);
}

void synthesis_limit(struct synthesis *synthesis, uint8_t actuator, uint16_t amplitude)
{
    synthesis->limits[actuator] = (int32_t)tones_displacement(QUARTER_TURN, amplitude * TONES_WORD_SCALE);
}

static int32_t loudness(const struct voice *voice)
{
    return voice->is_sounding ? voice->gain : 0;
}

void synthesis_play(struct synthesis *synthesis, const struct click *click, uint16_t amplitude)
{
    /* Clicks that the player knows as faded may all wait for the next sample: the quietest is at most a step from 0. */
    struct voice *quietest = &synthesis->voices[0];
    for (uint8_t i = 1; i < SYNTHESIS_VOICES; i++) {
        if (loudness(&synthesis->voices[i]) < loudness(quietest)) {
            quietest = &synthesis->voices[i];
        }
    }
    voice_play(quietest, click, amplitude * TONES_WORD_SCALE, synthesis->rate_hz, synthesis->number_of_actuators);
}

void synthesis_fade_clicks(struct synthesis *synthesis)
{
    for (uint8_t i = 0; i < SYNTHESIS_VOICES; i++) {
        synthesis->voices[i].is_fading = true;
    }
}

void synthesis_release(struct synthesis *synthesis, const uint8_t *first, const uint8_t *end)
{
    for (uint8_t i = 0; i < SYNTHESIS_VOICES; i++) {
        struct voice *voice = &synthesis->voices[i];
        const uint8_t *samples = voice->click.set.samples;
        if (voice->is_sounding && samples >= first && samples < end) {
            voice_freeze(voice, synthesis->number_of_actuators);
            voice->is_fading = true;
        }
    }
}

bool synthesis_is_silent(const struct synthesis *synthesis)
{
    if (!tones_are_silent(&synthesis->tones)) {
        return false;
    }
    for (uint8_t i = 0; i < SYNTHESIS_VOICES; i++) {
        if (synthesis->voices[i].is_sounding) {
            return false;
        }
    }
    return true;
}

void synthesis_sample(struct synthesis *synthesis, int16_t *displacements)
{
    int64_t sums[TACTABLE_ACTUATORS];
    tones_sample(&synthesis->tones, sums);
    for (uint8_t i = 0; i < SYNTHESIS_VOICES; i++) {
        if (synthesis->voices[i].is_sounding) {
            voice_add(&synthesis->voices[i], sums, synthesis->number_of_actuators);
            voice_advance(&synthesis->voices[i], synthesis->tones.slew, synthesis->number_of_actuators);
        }
    }
    for (uint8_t i = 0; i < synthesis->number_of_actuators; i++) {
        displacements[i] = output(sums[i], synthesis->limits[i]);
    }
    synthesis->samples++;
}
