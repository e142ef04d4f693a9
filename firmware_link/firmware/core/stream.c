#include "stream.h"

#include "device_time.h"
#include "reports.h"

/* Records of a whole frame: each has its acceleration and the displacement of every actuator. */
static uint32_t whole_frame(const struct tactable_device *device)
{
    return TACTABLE_MAXIMUM_SENSED_VALUES / (1u + device->configuration.number_of_actuators);
}

static void send_frame(struct tactable_device *device)
{
    const uint32_t records = sense_run(&device->sense, whole_frame(device));
    reports_send_acceleration(device, records);
    sense_drop(&device->sense, records);
    device->sense.frame++;
}

enum outcome stream_ask(struct tactable_device *device, const uint8_t *body)
{
    struct tactable_sense message;
    if (!tactable_read_sense(body, &message) || !state_has_accelerometer(device)) {
        return OUTCOME_REFUSED;
    }
    if (message.lease_ms == 0) {
        stream_end(device);
    } else {
        const uint32_t lease_ms =
            message.lease_ms < TACTABLE_LONGEST_SENSE_MS ? message.lease_ms : TACTABLE_LONGEST_SENSE_MS;
        device->sense.end_us = device->now_us + lease_ms * US_PER_MS;
        device->sense.is_on = true;
    }
    reports_send_sensor(device);
    return OUTCOME_ACCEPTED;
}

void stream_advance(struct tactable_device *device)
{
    while (device->sense.is_on && sense_waiting(&device->sense) >= whole_frame(device)) {
        send_frame(device);
    }
}

void stream_end(struct tactable_device *device)
{
    device->sense.is_on = false;
    while (sense_waiting(&device->sense) != 0) {
        send_frame(device);
    }
    device->sense.end_us = NEVER_US;
}

void stream_cut(struct tactable_device *device)
{
    device->sense.is_on = false;
    sense_drop(&device->sense, sense_waiting(&device->sense));
    device->sense.end_us = NEVER_US;
}
