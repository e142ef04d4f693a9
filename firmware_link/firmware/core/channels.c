#include "channels.h"

static uint16_t clamp(uint16_t value, uint16_t minimum, uint16_t maximum)
{
    return value < minimum ? minimum : value > maximum ? maximum : value;
}

/* Words of a SET for one actuator, clamped to its limits. */
static struct tactable_set_channel wanted(const struct channels *channels, const uint8_t *set_body, uint8_t actuator)
{
    struct tactable_set_channel words = tactable_read_set_channel(set_body, actuator);
    words.frequency = clamp(words.frequency, channels->frequency_minimum, channels->frequency_maximum);
    words.amplitude = clamp(words.amplitude, 0, channels->channels[actuator].limit);
    return words;
}

static bool is_written_so(const struct channel *channel, const struct tactable_set_channel *words)
{
    return channel->write != 0 && channel->written_frequency == words->frequency && channel->written_phase == words->phase;
}

/* Whether every channel that is to sound runs already as one and the same earlier phase write set it. */
static bool run_already(const struct channels *channels, const uint8_t *set_body)
{
    const struct channel *first = NULL;
    for (uint8_t i = 0; i < channels->number_of_actuators; i++) {
        const struct channel *channel = &channels->channels[i];
        const struct tactable_set_channel words = wanted(channels, set_body, i);
        if (words.amplitude == 0) {
            continue;
        }
        first = first == NULL ? channel : first;
        if (!is_written_so(channel, &words) || channel->write != first->write) {
            return false;
        }
    }
    return true;
}

/* Sets frequency and, with a `number` above 0, phase of a sounding channel. */
static void write(struct channel *channel, const struct tactable_set_channel *words, uint32_t number)
{
    if (number != 0) {
        channel->write = number;
        channel->written_frequency = words->frequency;
        channel->written_phase = words->phase;
    } else if (words->frequency != channel->frequency) {
        channel->write = 0;
    }
    channel->frequency = words->frequency;
}

void channels_start(struct channels *channels, uint8_t number_of_actuators, uint16_t minimum, uint16_t maximum)
{
    *channels = (struct channels){
        .number_of_actuators = number_of_actuators,
        .frequency_minimum = minimum,
        .frequency_maximum = maximum,
    };
    for (uint8_t i = 0; i < number_of_actuators; i++) {
        channels->channels[i].frequency = minimum;
    }
}

bool channels_are_driving(const struct channels *channels)
{
    for (uint8_t i = 0; i < channels->number_of_actuators; i++) {
        if (channels->channels[i].amplitude != 0) {
            return true;
        }
    }
    return false;
}

void channels_take_limits(struct channels *channels)
{
    for (uint8_t i = 0; i < channels->number_of_actuators; i++) {
        channels->channels[i].limit = channels->limits_to_come[i];
    }
}

enum channels_change channels_apply(struct channels *channels, const uint8_t *set_body, bool writes_phase)
{
    const bool writes_now = writes_phase && !run_already(channels, set_body);
    bool is_changed = false;
    channels->writes += writes_now;
    for (uint8_t i = 0; i < channels->number_of_actuators; i++) {
        struct channel *channel = &channels->channels[i];
        const struct tactable_set_channel words = wanted(channels, set_body, i);
        is_changed = is_changed || words.amplitude != channel->amplitude;
        channel->amplitude = words.amplitude;
        if (words.amplitude == 0) {
            continue;
        }
        is_changed = is_changed || words.frequency != channel->frequency;
        write(channel, &words, writes_now ? channels->writes : 0);
    }
    if (writes_now) {
        return CHANNELS_WRITTEN;
    }
    return is_changed ? CHANNELS_CHANGED : CHANNELS_UNCHANGED;
}

void channels_silence(struct channels *channels)
{
    for (uint8_t i = 0; i < channels->number_of_actuators; i++) {
        channels->channels[i].amplitude = 0;
    }
}
