#include "drive.h"

#include "device_time.h"
#include "reports.h"

static uint16_t lesser(uint32_t one, uint32_t other)
{
    return (uint16_t)(one < other ? one : other);
}

/* Hands the targets of all actuators to the synthesis, at one instant. */
static void aim(struct tactable_device *device, bool writes_phase)
{
    struct tones_target targets[TACTABLE_ACTUATORS];
    for (uint8_t i = 0; i < device->configuration.number_of_actuators; i++) {
        const struct channel *channel = &device->channels.channels[i];
        targets[i] = (struct tones_target){
            .frequency = channel->frequency,
            .amplitude = lesser(channel->amplitude, channel->limit),
            .phase = channel->written_phase,
            .writes_phase = writes_phase && channel->amplitude != 0,
        };
    }
    tones_aim(&device->synthesis.tones, targets);
}

static void hold_samples(struct tactable_device *device)
{
    device->hooks.hold_samples(device->hooks.context);
}

static void release_samples(struct tactable_device *device)
{
    device->hooks.release_samples(device->hooks.context);
}

/* Puts the limits of the last ARM into force. */
static void take_limits(struct tactable_device *device)
{
    channels_take_limits(&device->channels);
    device->slew_per_s = device->slew_to_come_per_s;
    tones_slew(&device->synthesis.tones, device->slew_per_s);
    for (uint8_t i = 0; i < device->configuration.number_of_actuators; i++) {
        synthesis_limit(&device->synthesis, i, device->channels.channels[i].limit);
    }
}

/* Lets the click that plays fade. */
static void take_over(struct tactable_device *device)
{
    player_take_over(&device->player, device->now_us, device->slew_per_s);
    synthesis_fade_clicks(&device->synthesis);
}

/* A command was applied: STATUS reports it soon. */
static void applied(struct tactable_device *device, uint8_t sequence, enum tactable_device_state state)
{
    device->counters.applied++;
    device->reports.applied_sequence = sequence;
    device->reports.applied_time_us = device->now_us;
    const uint64_t allowed_us = device->reports.status_allowed_us;
    state_want_status(device, allowed_us > device->now_us ? allowed_us : device->now_us);
    state_enter(device, state);
}

static enum outcome check(const struct tactable_device *device, uint16_t clock_reference, uint8_t sequence)
{
    if (!state_is_armed(device)) {
        return OUTCOME_REFUSED;
    }
    return lease_is_fresh(&device->lease, clock_reference, sequence, device->now_us) ? OUTCOME_ACCEPTED : OUTCOME_STALE;
}

/* Applies the drive of a SET; returns whether any amplitude is above zero. */
static bool take(struct tactable_device *device, const uint8_t *body, bool writes_phase)
{
    hold_samples(device);
    take_limits(device);
    take_over(device);
    const enum channels_change change = channels_apply(&device->channels, body, writes_phase);
    if (change != CHANNELS_UNCHANGED) {
        aim(device, change == CHANNELS_WRITTEN);
    }
    release_samples(device);
    return channels_are_driving(&device->channels);
}

enum outcome drive_set(struct tactable_device *device, const uint8_t *body, uint8_t sequence)
{
    struct tactable_set message;
    if (!tactable_read_set(body, &message)) {
        return OUTCOME_REFUSED;
    }
    const enum outcome outcome = check(device, message.clock_reference, sequence);
    if (outcome != OUTCOME_ACCEPTED) {
        return outcome;
    }
    lease_refresh(&device->lease, sequence, device->now_us);
    const uint64_t asked_us = (uint64_t)message.lease_ms * US_PER_MS;
    device->lease.drive_us = asked_us < device->lease.armed_us ? asked_us : device->lease.armed_us;
    device->lease.renewed_us = device->now_us;
    const bool is_driving = take(device, body, message.flags & TACTABLE_SET_FLAG_WRITE_PHASE);
    applied(device, sequence, is_driving ? TACTABLE_DEVICE_STATE_DRIVING : TACTABLE_DEVICE_STATE_ARMED);
    return OUTCOME_ACCEPTED;
}

/* Looks the set of a PLAY up; false where none is held that the weights fit. */
static bool find_set(const struct tactable_device *device, const struct tactable_play *message, struct basis_set *set)
{
    return basis_find_set(&device->basis, message->basis_set, set)
        && set->number_of_functions == message->number_of_weights
        && message->fraction_bits != 0 && message->fraction_bits <= TACTABLE_MAXIMUM_FRACTION_BITS;
}

/* Bounds a click by the limits in force and the highest frequency of the device. */
static void bound(const struct tactable_device *device, struct click *click)
{
    const struct tactable_configuration *configuration = &device->configuration;
    const uint32_t frequency_maximum_uhz =
        (uint32_t)configuration->frequency_maximum * configuration->frequency_resolution_uhz;
    for (uint8_t i = 0; i < configuration->number_of_actuators; i++) {
        click_limit(click, i, device->channels.channels[i].limit, frequency_maximum_uhz);
    }
}

enum outcome drive_play(struct tactable_device *device, const uint8_t *body, uint8_t sequence)
{
    struct tactable_play message;
    struct basis_set set;
    struct click *click = &device->click;
    if (!tactable_read_play(body, &message)) {
        return OUTCOME_REFUSED;
    }
    const enum outcome outcome = check(device, message.clock_reference, sequence);
    if (outcome != OUTCOME_ACCEPTED) {
        return outcome;
    }
    if (!find_set(device, &message, &set) || !player_has_room(&device->player, device->now_us)) {
        reports_send_log(device, TACTABLE_LOG_LEVEL_WARNING, TACTABLE_LOG_CODE_PLAY_REFUSED, message.basis_set);
        return OUTCOME_REFUSED;
    }
    lease_refresh(&device->lease, sequence, device->now_us);
    click_start(click, &set, body, message.fraction_bits);
    hold_samples(device);
    take_limits(device);
    take_over(device);
    channels_silence(&device->channels);
    aim(device, false);
    bound(device, click);
    synthesis_play(&device->synthesis, click, message.amplitude);
    release_samples(device);
    player_play(&device->player, device->now_us, set.length_us, message.amplitude);
    applied(device, sequence, TACTABLE_DEVICE_STATE_DRIVING);
    return OUTCOME_ACCEPTED;
}

enum outcome drive_keep_alive(struct tactable_device *device, const uint8_t *body, uint8_t sequence)
{
    struct tactable_keepalive message;
    if (!tactable_read_keepalive(body, &message)) {
        return OUTCOME_REFUSED;
    }
    const enum outcome outcome = check(device, message.clock_reference, sequence);
    if (outcome == OUTCOME_ACCEPTED) {
        lease_refresh(&device->lease, sequence, device->now_us);
        if (message.applied_sequence == device->reports.applied_sequence) {
            device->lease.renewed_us = device->now_us;
        }
    }
    return outcome;
}

void drive_silence(struct tactable_device *device)
{
    const bool is_commanded = channels_are_driving(&device->channels) || device->player.end_us != NEVER_US;
    /* What sounds, not only what should: a click must not outlast a stop, whenever it was thought to end. */
    if (!is_commanded && synthesis_is_silent(&device->synthesis)) {
        return;
    }
    hold_samples(device);
    channels_silence(&device->channels);
    aim(device, false);
    take_over(device);
    release_samples(device);
}

void drive_release_transfer(struct tactable_device *device)
{
    hold_samples(device);
    const uint8_t *first = device->basis.bytes + device->basis.transfer.at;
    synthesis_release(&device->synthesis, first, first + device->basis.transfer.size);
    release_samples(device);
}
