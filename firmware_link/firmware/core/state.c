#include "state.h"

#include "device_time.h"

bool state_is_armed(const struct tactable_device *device)
{
    return device->state == TACTABLE_DEVICE_STATE_ARMED || device->state == TACTABLE_DEVICE_STATE_DRIVING;
}

bool state_has_accelerometer(const struct tactable_device *device)
{
    const struct tactable_configuration *configuration = &device->configuration;
    return configuration->sensor_rate_mhz != 0 && configuration->number_of_actuators < TACTABLE_MAXIMUM_SENSED_VALUES;
}

void state_enter(struct tactable_device *device, enum tactable_device_state state)
{
    if (state == device->state) {
        return;
    }
    if (state == TACTABLE_DEVICE_STATE_DRIVING) {
        device->driving_since_us = device->now_us;
    }
    if (state_is_armed(device)) {
        device->disarmed_us = device->now_us;
    }
    device->state = state;
    state_want_status(device, device->now_us);
}

void state_want_status(struct tactable_device *device, uint64_t due_us)
{
    device->status_due_us = earlier_us(due_us, device->status_due_us);
}
