#include "synthesis.h"

#include "device_time.h"
#include "sine.h"

#define QUARTER_TURN 0x40000000u
/* sine_of() has 30 bits behind the point; displacements are summed with 2^16 to one step of the output. */
#define SINE_ONE (1 << 30)
#define OUTPUT_STEP (1 << 16)
#define UHZ_PER_HZ 1000000u

static int64_t tone(uint32_t phase, int32_t amplitude)
{
    return (int64_t)sine_of(phase) * amplitude / SINE_ONE;
}

/* Nearest phase step; the greatest frequency, 65535 words of 65535 uHz, just fits. */
static uint32_t increment_of(const struct synthesis *synthesis, uint16_t frequency)
{
    const uint64_t frequency_uhz = (uint64_t)frequency * synthesis->frequency_resolution_uhz;
    const uint64_t rate_uhz = (uint64_t)synthesis->rate_hz * UHZ_PER_HZ;
    return (uint32_t)(((frequency_uhz << 32) + rate_uhz / 2u) / rate_uhz);
}

static int32_t stepped(int32_t value, int32_t goal, int32_t step)
{
    if (value < goal) {
        return goal - value > step ? value + step : goal;
    }
    return value - goal > step ? value - step : goal;
}

static int64_t channel_sample(struct synthesis_channel *channel, int32_t slew)
{
    if (channel->has_next && channel->amplitude == 0) {
        channel->oscillator = channel->next;
        channel->has_next = false;
    }
    const int64_t displacement = tone(channel->oscillator.phase, channel->amplitude);
    channel->oscillator.phase += channel->oscillator.increment;
    channel->next.phase += channel->next.increment;
    channel->amplitude = stepped(channel->amplitude, channel->has_next ? 0 : channel->target, slew);
    return displacement;
}

static int16_t output(int64_t displacement, int32_t limit)
{
    const int64_t clamped = displacement > limit ? limit : displacement < -limit ? -limit : displacement;
    return (int16_t)((clamped + (clamped < 0 ? -OUTPUT_STEP / 2 : OUTPUT_STEP / 2)) / OUTPUT_STEP);
}

void synthesis_start(
    struct synthesis *synthesis, uint8_t number_of_actuators, uint32_t rate_hz, uint32_t frequency_resolution_uhz)
{
    *synthesis = (struct synthesis){
        .number_of_actuators = number_of_actuators,
        .rate_hz = rate_hz,
        .frequency_resolution_uhz = frequency_resolution_uhz,
    };
    synthesis_slew(synthesis, 1);
}

void synthesis_slew(struct synthesis *synthesis, uint16_t slew_per_s)
{
    /* Rounded down: a ramp may be a little slower, never faster. */
    const uint64_t slew = (uint64_t)SYNTHESIS_FULL_SCALE * slew_per_s / synthesis->rate_hz;
    synthesis->slew = slew > SYNTHESIS_FULL_SCALE ? SYNTHESIS_FULL_SCALE : (int32_t)slew;
}

void synthesis_limit(struct synthesis *synthesis, uint8_t actuator, uint16_t amplitude)
{
    synthesis->channels[actuator].limit = (int32_t)tone(QUARTER_TURN, amplitude * SYNTHESIS_WORD_SCALE);
}

void synthesis_aim(struct synthesis *synthesis, uint8_t actuator, const struct synthesis_target *target)
{
    struct synthesis_channel *channel = &synthesis->channels[actuator];
    const uint32_t increment = increment_of(synthesis, target->frequency);
    channel->target = target->amplitude * SYNTHESIS_WORD_SCALE;
    if (target->writes_phase) {
        channel->next = (struct oscillator){(uint32_t)target->phase << 16, increment};
        channel->has_next = true;
    } else if (channel->has_next) {
        channel->next.increment = increment;
    } else {
        channel->oscillator.increment = increment;
    }
}

void synthesis_play(struct synthesis *synthesis, const struct click *click, uint16_t amplitude)
{
    for (uint8_t i = 0; i < SYNTHESIS_VOICES; i++) {
        if (!synthesis->voices[i].is_sounding) {
            voice_play(
                &synthesis->voices[i], click, amplitude * SYNTHESIS_WORD_SCALE, synthesis->rate_hz,
                synthesis->number_of_actuators);
            return;
        }
    }
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
    for (uint8_t i = 0; i < synthesis->number_of_actuators; i++) {
        if (synthesis->channels[i].amplitude != 0) {
            return false;
        }
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
    for (uint8_t i = 0; i < synthesis->number_of_actuators; i++) {
        sums[i] = channel_sample(&synthesis->channels[i], synthesis->slew);
    }
    for (uint8_t i = 0; i < SYNTHESIS_VOICES; i++) {
        if (synthesis->voices[i].is_sounding) {
            voice_add(&synthesis->voices[i], sums, synthesis->number_of_actuators);
            voice_advance(&synthesis->voices[i], synthesis->slew, synthesis->number_of_actuators);
        }
    }
    for (uint8_t i = 0; i < synthesis->number_of_actuators; i++) {
        displacements[i] = output(sums[i], synthesis->channels[i].limit);
    }
    synthesis->samples++;
}
