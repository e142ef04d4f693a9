#include "device.h"

#include "device_time.h"
#include "electrode.h"
#include "reports.h"
#include "session.h"
#include "stream.h"

/* A ramp at a slow slew may take a second; a disarmed supply does not wait for it. */
#define LONGEST_RAMP_US 100000u

static uint64_t drive_end_us(const struct tactable_device *device)
{
    return channels_are_driving(&device->channels) ? lease_end_us(&device->lease) : NEVER_US;
}

static uint64_t watchdog_end_us(const struct tactable_device *device)
{
    return state_is_armed(device) ? lease_watchdog_end_us(&device->lease) : NEVER_US;
}

static uint64_t on_time_end_us(const struct tactable_device *device)
{
    const bool is_limited = device->state == TACTABLE_DEVICE_STATE_DRIVING && device->longest_drive_us != NEVER_US;
    return is_limited ? device->driving_since_us + device->longest_drive_us : NEVER_US;
}

static void expire_lease(struct tactable_device *device)
{
    device->counters.trips++;
    session_silence(device, TACTABLE_DEVICE_STATE_ARMED);
    reports_send_log(
        device, TACTABLE_LOG_LEVEL_WARNING, TACTABLE_LOG_CODE_LEASE_EXPIRED, device->reports.applied_sequence);
}

/* The order is the protocol's: what comes later sees what came before. */
static void act_on_deadlines(struct tactable_device *device)
{
    if (device->player.end_us <= device->now_us) {
        player_finish(&device->player);
        state_enter(device, TACTABLE_DEVICE_STATE_ARMED);
    }
    if (drive_end_us(device) <= device->now_us) {
        expire_lease(device);
    }
    if (on_time_end_us(device) <= device->now_us) {
        session_latch(device, TACTABLE_FAULT_CODE_DRIVEN_TOO_LONG);
    }
    if (watchdog_end_us(device) <= device->now_us) {
        session_latch(device, TACTABLE_FAULT_CODE_SILENT_HOST);
    }
    reports_advance(device);
    if (device->sense.end_us <= device->now_us) {
        stream_end(device);
    }
}

void tactable_device_start(
    struct tactable_device *device, const struct tactable_configuration *configuration, const struct tactable_hooks *hooks)
{
    const uint8_t number_of_actuators = configuration->number_of_actuators;
    *device = (struct tactable_device){
        .configuration = *configuration,
        .hooks = *hooks,
        .state = TACTABLE_DEVICE_STATE_IDLE,
        .status_due_us = NEVER_US,
        .reports = {.fault_due_us = NEVER_US},
        .slew_per_s = 1,
        .slew_to_come_per_s = 1,
        .longest_drive_us = NEVER_US,
        .basis = {
            .bytes = configuration->basis,
            .capacity_bytes = configuration->basis_capacity_bytes,
            .longest_waveform_us = configuration->longest_waveform_ms * US_PER_MS,
            .number_of_actuators = number_of_actuators,
        },
    };
    framing_start(&device->framing, number_of_actuators);
    channels_start(
        &device->channels, number_of_actuators, configuration->frequency_minimum, configuration->frequency_maximum);
    player_start(&device->player);
    sense_start(&device->sense, number_of_actuators);
    synthesis_start(
        &device->synthesis, number_of_actuators, configuration->synthesis_rate_hz, configuration->frequency_resolution_uhz);
}

void tactable_device_receive(struct tactable_device *device, const uint8_t *bytes, size_t length, uint64_t now_us)
{
    tactable_device_advance(device, now_us);
    for (size_t i = 0; i < length; i++) {
        switch (framing_take(&device->framing, bytes[i])) {
        case FRAMING_BODY:
            session_act_on(device, device->framing.buffer);
            break;
        case FRAMING_EMERGENCY_STOP:
            session_latch(device, TACTABLE_FAULT_CODE_EMERGENCY_STOP);
            break;
        case FRAMING_NOTHING:
            break;
        }
    }
    tactable_device_advance(device, now_us);
}

void tactable_device_advance(struct tactable_device *device, uint64_t now_us)
{
    uint64_t deadline_us = tactable_device_next_deadline_us(device);
    while (deadline_us <= now_us) {
        device->now_us = deadline_us > device->now_us ? deadline_us : device->now_us;
        act_on_deadlines(device);
        deadline_us = tactable_device_next_deadline_us(device);
    }
    device->now_us = now_us;
    stream_advance(device);
}

void tactable_device_emergency_stop(struct tactable_device *device, uint64_t now_us)
{
    tactable_device_advance(device, now_us);
    session_latch(device, TACTABLE_FAULT_CODE_EMERGENCY_STOP);
    tactable_device_advance(device, now_us);
}

void tactable_device_hang_up(struct tactable_device *device, uint64_t now_us)
{
    tactable_device_advance(device, now_us);
    stream_cut(device);
    if (state_is_armed(device)) {
        session_latch(device, TACTABLE_FAULT_CODE_HUNG_UP);
    }
    tactable_device_advance(device, now_us);
}

uint64_t tactable_device_next_deadline_us(const struct tactable_device *device)
{
    uint64_t deadline_us = earlier_us(device->player.end_us, drive_end_us(device));
    deadline_us = earlier_us(deadline_us, on_time_end_us(device));
    deadline_us = earlier_us(deadline_us, watchdog_end_us(device));
    deadline_us = earlier_us(deadline_us, device->sense.end_us);
    return earlier_us(deadline_us, earlier_us(device->reports.fault_due_us, device->status_due_us));
}

bool tactable_device_allows_high_voltage(const struct tactable_device *device)
{
    if (state_is_armed(device)) {
        return true;
    }
    return !synthesis_is_silent(&device->synthesis) && device->now_us < device->disarmed_us + LONGEST_RAMP_US;
}

void tactable_device_sample(struct tactable_device *device, int16_t *displacements)
{
    const uint32_t sample = device->synthesis.samples;
    synthesis_sample(&device->synthesis, displacements);
    sense_remember(&device->sense, sample, displacements);
}

void tactable_device_linearise(const struct tactable_device *device, int16_t *displacements)
{
    const uint16_t bias = device->configuration.electrode_bias;
    for (uint8_t i = 0; bias != 0 && i < device->configuration.number_of_actuators; i++) {
        displacements[i] = electrode_output(bias, displacements[i]);
    }
}

void tactable_device_sense(struct tactable_device *device, int16_t acceleration)
{
    const uint32_t sample = device->synthesis.samples - 1u - device->configuration.sensor_delay_samples;
    sense_take(&device->sense, acceleration, sense_recall(&device->sense, sample), sample);
}
