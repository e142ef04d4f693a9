#include "reports.h"

#include "device_time.h"

#define STATUS_PERIOD_US 100000u
#define STATUS_SPACING_US 10000u
#define FAULT_PERIOD_US 100000u
#define LOG_SPACING_US 10000u

#define FIRMWARE_MAJOR 0
#define FIRMWARE_MINOR 2
#define FIRMWARE_PATCH 0

/* Size of a body that a device sends, with room for its checksum, and of its frame. */
#define BODY_ROOM (TACTABLE_SENT_BODY_BOUND(TACTABLE_ACTUATORS) + FRAMING_CHECKSUM_SIZE)
#define FRAME_ROOM (COBS_BOUND(BODY_ROOM) + 1u)

static uint8_t next_sequence(struct reports *reports)
{
    return ++reports->sequence;
}

static void send(struct tactable_device *device, uint8_t *body, const uint8_t *end)
{
    uint8_t frame[FRAME_ROOM];
    const size_t length = framing_encode(body, (size_t)(end - body), frame);
    device->hooks.send(device->hooks.context, frame, length);
}

static uint32_t features_of(const struct tactable_device *device)
{
    const struct tactable_configuration *configuration = &device->configuration;
    uint32_t features = configuration->basis_capacity_bytes != 0 ? TACTABLE_FEATURES_WAVEFORMS : 0u;
    features |= configuration->senses_high_voltage ? TACTABLE_FEATURES_HIGH_VOLTAGE_SENSE : 0u;
    features |= state_has_accelerometer(device) ? TACTABLE_ACCELEROMETER : 0u;
    features |= configuration->electrode_bias != 0 ? TACTABLE_LINEARISES : 0u;
    return features;
}

static void send_status(struct tactable_device *device)
{
    const struct framing_counters *framing = &device->framing.counters;
    const struct tactable_status status = {
        .state = (uint8_t)device->state,
        .fault = (uint8_t)device->reports.fault,
        .applied_sequence = device->reports.applied_sequence,
        .device_time_us = device->now_us,
        .applied_time_us = device->reports.applied_time_us,
        .high_voltage_dv = device->high_voltage_dv,
        .applied = device->counters.applied,
        .ok = framing->ok,
        .crc = framing->crc,
        .framing = framing->framing,
        .length = framing->length,
        .overrun = framing->overrun,
        .stale = device->counters.stale,
        .refused = device->counters.refused,
        .trips = device->counters.trips,
    };
    uint8_t body[BODY_ROOM];
    send(device, body, tactable_write_status(body, next_sequence(&device->reports), &status));
}

static void send_fault(struct tactable_device *device)
{
    const struct tactable_fault fault = {
        .fault = (uint8_t)device->reports.fault,
        .device_time_us = device->reports.fault_time_us,
    };
    uint8_t body[BODY_ROOM];
    send(device, body, tactable_write_fault(body, device->reports.fault_sequence, &fault));
}

void reports_send_hello(struct tactable_device *device, uint32_t nonce)
{
    const struct tactable_configuration *configuration = &device->configuration;
    const struct tactable_hello hello = {
        .version_major = TACTABLE_VERSION_MAJOR,
        .version_minor = TACTABLE_VERSION_MINOR,
        .nonce = nonce,
        .boot_id = configuration->boot_id,
        .schema_hash = TACTABLE_SCHEMA_HASH,
        .features = features_of(device),
        .firmware_major = FIRMWARE_MAJOR,
        .firmware_minor = FIRMWARE_MINOR,
        .firmware_patch = FIRMWARE_PATCH,
        .board = configuration->board,
        .synthesis_rate_hz = configuration->synthesis_rate_hz,
        .frequency_resolution_uhz = configuration->frequency_resolution_uhz,
        .frequency_minimum = configuration->frequency_minimum,
        .frequency_maximum = configuration->frequency_maximum,
        .longest_lease_ms = configuration->longest_lease_ms,
        .longest_waveform_ms = configuration->longest_waveform_ms,
        .basis_capacity_bytes = configuration->basis_capacity_bytes,
        .held_basis_hash = device->basis.held.hash,
        .number_of_actuators = configuration->number_of_actuators,
    };
    uint8_t body[BODY_ROOM];
    uint8_t *end = tactable_write_hello(body, next_sequence(&device->reports), &hello);
    for (uint8_t i = 0; i < configuration->number_of_actuators; i++) {
        const struct tactable_hello_channel channel = {configuration->full_scales_pm[i]};
        end = tactable_write_hello_channel(end, &channel);
    }
    send(device, body, end);
}

void reports_send_ack(struct tactable_device *device, uint8_t type, uint8_t sequence, enum tactable_result result)
{
    const struct tactable_ack ack = {type, sequence, (uint8_t)result};
    uint8_t body[BODY_ROOM];
    send(device, body, tactable_write_ack(body, next_sequence(&device->reports), &ack));
}

void reports_send_time(struct tactable_device *device, uint64_t host_sent_ns)
{
    const struct tactable_time time = {host_sent_ns, device->now_us, device->now_us};
    uint8_t body[BODY_ROOM];
    send(device, body, tactable_write_time(body, next_sequence(&device->reports), &time));
}

void reports_send_log(
    struct tactable_device *device, enum tactable_log_level level, enum tactable_log_code code, uint32_t value)
{
    if (device->now_us < device->reports.log_allowed_us) {
        return;
    }
    device->reports.log_allowed_us = device->now_us + LOG_SPACING_US;
    const struct tactable_log log = {(uint8_t)level, (uint16_t)code, value, device->now_us};
    uint8_t body[BODY_ROOM];
    send(device, body, tactable_write_log(body, next_sequence(&device->reports), &log));
}

void reports_send_sensor(struct tactable_device *device)
{
    const struct tactable_configuration *configuration = &device->configuration;
    const struct tactable_sensor sensor = {
        .rate_mhz = configuration->sensor_rate_mhz,
        .scale_nm_per_s2 = configuration->sensor_scale_nm_per_s2,
        .greatest = configuration->sensor_greatest,
        .lost = device->sense.lost,
    };
    uint8_t body[BODY_ROOM];
    send(device, body, tactable_write_sensor(body, next_sequence(&device->reports), &sensor));
}

void reports_send_acceleration(struct tactable_device *device, uint32_t records)
{
    const uint8_t number_of_actuators = device->configuration.number_of_actuators;
    const volatile struct sense_record *first = sense_waiting_at(&device->sense, 0);
    const struct tactable_acceleration acceleration = {
        .frame = device->sense.frame,
        .number = first->number,
        .synthesis_sample = first->synthesis_sample,
        .number_of_values = (uint8_t)(records * (1u + number_of_actuators)),
    };
    uint8_t body[BODY_ROOM];
    uint8_t *end = tactable_write_acceleration(body, next_sequence(&device->reports), &acceleration);
    for (uint32_t i = 0; i < records; i++) {
        const volatile struct sense_record *record = sense_waiting_at(&device->sense, i);
        end = put_i16(end, record->acceleration);
        for (uint8_t actuator = 0; actuator < number_of_actuators; actuator++) {
            end = put_i16(end, record->displacements[actuator]);
        }
    }
    send(device, body, end);
}

void reports_raise_fault(struct tactable_device *device, enum tactable_fault_code fault)
{
    struct reports *reports = &device->reports;
    reports->fault = fault;
    reports->fault_time_us = reports->fault_due_us = device->now_us;
    reports->fault_sequence = next_sequence(reports);
}

bool reports_settle_fault(struct reports *reports, const struct tactable_ack *ack)
{
    if (ack->acknowledged_type != TACTABLE_FAULT_TYPE || ack->acknowledged_sequence != reports->fault_sequence) {
        return false;
    }
    reports->fault = TACTABLE_FAULT_CODE_NONE;
    reports->fault_due_us = NEVER_US;
    return true;
}

void reports_advance(struct tactable_device *device)
{
    struct reports *reports = &device->reports;
    if (reports->fault_due_us <= device->now_us) {
        send_fault(device);
        reports->fault_due_us = device->now_us + FAULT_PERIOD_US;
    }
    if (device->status_due_us <= device->now_us) {
        send_status(device);
        reports->status_allowed_us = device->now_us + STATUS_SPACING_US;
        device->status_due_us = device->now_us + STATUS_PERIOD_US;
    }
}
