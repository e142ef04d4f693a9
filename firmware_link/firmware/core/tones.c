#include "tones.h"

#include <stddef.h>

#include "sine.h"

/* sine_of() has 30 bits behind the point. */
#define SINE_ONE (1 << 30)
#define W_ONE (1u << 30)
/* Rounding leaves w short of 1 by less than this where the transition is over. */
#define W_ARRIVED (W_ONE - (W_ONE >> 16))
#define UHZ_PER_HZ 1000000u
/* Less is silence: half of the least amplitude that a SET can ask for. */
#define SILENT (TONES_WORD_SCALE / 2)

int64_t tones_displacement(uint32_t phase, int32_t amplitude)
{
    return (int64_t)sine_of(phase) * amplitude / SINE_ONE;
}

/* Nearest phase step; the greatest frequency, 65535 words of 65535 uHz, just fits. */
static uint32_t increment_of(const struct tones *tones, uint16_t frequency)
{
    const uint64_t frequency_uhz = (uint64_t)frequency * tones->frequency_resolution_uhz;
    const uint64_t rate_uhz = (uint64_t)tones->rate_hz * UHZ_PER_HZ;
    return (uint32_t)(((frequency_uhz << 32) + rate_uhz / 2u) / rate_uhz);
}

static int32_t between(int32_t start, int32_t goal, uint32_t w)
{
    return w >= W_ARRIVED ? goal : start + (int32_t)((int64_t)(goal - start) * (int32_t)w / (int32_t)W_ONE);
}

/* Amplitude of the oscillator that a channel plays, and of the one that fades. */
static int32_t amplitude_of(const struct tones_channel *channel)
{
    return between(channel->amplitude, channel->goal, channel->w);
}

static int32_t fading_of(const struct tones_channel *channel)
{
    return between(channel->fading, 0, channel->w);
}

/* Whether the next transition of a channel is a crossfade. */
static bool is_to_crossfade(const struct tones_channel *channel)
{
    return channel->is_written && amplitude_of(channel) >= SILENT;
}

/* Step of w by which amplitudes that go this far together keep the slew: rounded down, never faster. */
static uint32_t step_of(const struct tones *tones, int64_t change)
{
    return change <= tones->slew ? W_ONE : (uint32_t)((int64_t)tones->slew * (int32_t)W_ONE / change);
}

/* Step of w of one channel on the way to its target. */
static uint32_t step_to_target(const struct tones *tones, const struct tones_channel *channel)
{
    const int64_t amplitude = amplitude_of(channel);
    if (is_to_crossfade(channel)) {
        return step_of(tones, amplitude + channel->target);
    }
    return step_of(tones, channel->target > amplitude ? channel->target - amplitude : amplitude - channel->target);
}

/* The channel that goes on in phase: of those that crossfade the one with the greatest target; NULL: none does. */
static const struct tones_channel *loudest(const struct tones *tones)
{
    const struct tones_channel *found = NULL;
    for (uint8_t i = 0; i < tones->number_of_actuators; i++) {
        const struct tones_channel *channel = &tones->channels[i];
        if (is_to_crossfade(channel) && (found == NULL || channel->target > found->target)) {
            found = channel;
        }
    }
    return found;
}

/* Part of a sample, times W_ONE, that has passed since a crossfade ended: with its slowest channel, since one that falls
 * to silence instead has a w of its own for each. */
static uint32_t lateness(const struct tones *tones)
{
    const struct tones_channel *last = &tones->channels[0];
    for (uint8_t i = 1; i < tones->number_of_actuators; i++) {
        last = tones->channels[i].step < last->step ? &tones->channels[i] : last;
    }
    return last->w < W_ONE ? 0 : (uint32_t)((uint64_t)(last->w - W_ONE) * W_ONE / last->step);
}

/* The angle between the two oscillators of a channel that is to crossfade, `late` before this sample. */
static uint32_t angle_between(const struct tones_channel *channel, uint32_t late)
{
    const int32_t faster = (int32_t)(channel->oscillator.increment - channel->written.increment);
    const int32_t since = (int32_t)((int64_t)faster * (int32_t)late / (int32_t)W_ONE);
    return channel->oscillator.phase - channel->written.phase - (uint32_t)since;
}

static void begin_channel(struct tones_channel *channel, uint32_t angle)
{
    const int32_t amplitude = amplitude_of(channel);
    const bool crossfades = is_to_crossfade(channel);
    channel->fading = crossfades ? amplitude : 0;
    channel->amplitude = channel->is_written ? 0 : amplitude;
    channel->goal = channel->target;
    if (channel->is_written) {
        channel->faded = channel->oscillator;
        channel->oscillator = channel->written;
        channel->oscillator.phase += angle;
        channel->is_written = false;
    }
}

/* Sends all channels to their targets: along one w, or from silence each for itself. `late`: part of a sample, times
 * W_ONE, since this could have been done. */
static void begin(struct tones *tones, uint32_t late)
{
    const struct tones_channel *reference = loudest(tones);
    const uint32_t angle = reference == NULL ? 0 : angle_between(reference, late);
    bool is_silent = true;
    uint32_t least_step = W_ONE;
    for (uint8_t i = 0; i < tones->number_of_actuators; i++) {
        struct tones_channel *channel = &tones->channels[i];
        is_silent = is_silent && amplitude_of(channel) < SILENT;
        channel->step = step_to_target(tones, channel);
        least_step = channel->step < least_step ? channel->step : least_step;
    }
    for (uint8_t i = 0; i < tones->number_of_actuators; i++) {
        struct tones_channel *channel = &tones->channels[i];
        begin_channel(channel, angle);
        channel->step = is_silent ? channel->step : least_step;
        channel->w = (uint32_t)((uint64_t)channel->step * late / W_ONE);
    }
    tones->is_crossfading = reference != NULL;
    tones->is_waiting = false;
}

/* Sends all channels to silence; an oscillator that was written is kept for the next target. */
static void fall(struct tones *tones)
{
    tones->is_waiting = false;
    for (uint8_t i = 0; i < tones->number_of_actuators; i++) {
        struct tones_channel *channel = &tones->channels[i];
        const int32_t amplitude = amplitude_of(channel);
        channel->fading = fading_of(channel);
        channel->amplitude = amplitude;
        channel->goal = 0;
        channel->step = step_of(tones, (int64_t)amplitude + channel->fading);
        channel->w = 0;
    }
}

/* Notes the end of a crossfade, and begins what waits for that. */
static void end_crossfade(struct tones *tones)
{
    bool is_over = true;
    for (uint8_t i = 0; i < tones->number_of_actuators; i++) {
        is_over = is_over && tones->channels[i].w >= W_ARRIVED;
    }
    if (tones->is_crossfading && is_over) {
        tones->is_crossfading = false;
        if (tones->is_waiting) {
            begin(tones, lateness(tones));
        }
    }
}

static void take(struct tones_channel *channel, const struct tones_target *target, uint32_t increment)
{
    channel->target = target->amplitude * TONES_WORD_SCALE;
    if (target->writes_phase) {
        channel->written = (struct oscillator){(uint32_t)target->phase << 16, increment};
        channel->is_written = true;
    } else if (channel->is_written) {
        channel->written.increment = increment;
    } else {
        channel->oscillator.increment = increment;
    }
}

void tones_start(
    struct tones *tones, uint8_t number_of_actuators, uint32_t rate_hz, uint32_t frequency_resolution_uhz)
{
    *tones = (struct tones){
        .number_of_actuators = number_of_actuators,
        .rate_hz = rate_hz,
        .frequency_resolution_uhz = frequency_resolution_uhz,
    };
    tones_slew(tones, 1);
}

void tones_slew(struct tones *tones, uint16_t slew_per_s)
{
    /* Rounded down: a ramp may be a little slower, never faster. */
    const uint64_t exact = (uint64_t)TONES_FULL_SCALE * slew_per_s / tones->rate_hz;
    const int32_t slew = exact > TONES_FULL_SCALE ? TONES_FULL_SCALE : (int32_t)exact;
    if (slew != tones->slew) {
        tones->slew = slew;
        fall(tones);
    }
}

void tones_aim(struct tones *tones, const struct tones_target *targets)
{
    bool is_silence = true;
    end_crossfade(tones);
    for (uint8_t i = 0; i < tones->number_of_actuators; i++) {
        take(&tones->channels[i], &targets[i], increment_of(tones, targets[i].frequency));
        is_silence = is_silence && targets[i].amplitude == 0;
    }
    if (is_silence) {
        fall(tones);
    } else if (tones->is_crossfading) {
        tones->is_waiting = true;
    } else {
        begin(tones, 0);
    }
}

void tones_sample(struct tones *tones, int64_t *displacements)
{
    end_crossfade(tones);
    for (uint8_t i = 0; i < tones->number_of_actuators; i++) {
        struct tones_channel *channel = &tones->channels[i];
        displacements[i] = tones_displacement(channel->oscillator.phase, amplitude_of(channel));
        channel->oscillator.phase += channel->oscillator.increment;
        channel->written.phase += channel->written.increment;
        if (channel->w < W_ARRIVED) {
            displacements[i] += tones_displacement(channel->faded.phase, fading_of(channel));
            channel->faded.phase += channel->faded.increment;
            channel->w += channel->step;
        }
    }
}

int32_t tones_amplitude(const struct tones_channel *channel)
{
    return amplitude_of(channel) + fading_of(channel);
}

bool tones_are_silent(const struct tones *tones)
{
    for (uint8_t i = 0; i < tones->number_of_actuators; i++) {
        const struct tones_channel *channel = &tones->channels[i];
        if (amplitude_of(channel) != 0 || fading_of(channel) != 0) {
            return false;
        }
    }
    return true;
}
