/* libFuzzer's bytes to a session: what is not armed does not drive, and nothing passes the limits, whatever comes.
 *
 * Each record is an operation, a time to let pass and up to 255 bytes: raw ones, or a body that gets its checksum here.
 */
#include <stdlib.h>
#include <string.h>

#include "device.h"
#include "framing.h"

#define ACTUATORS 3u
#define AMPLITUDE_LIMIT 40000u
#define GREATEST_OUTPUT 20000
#define TIME_STEP_US 37u
#define SAMPLES_A_RECORD 4u
#define BOOT_ID 7u
#define HEAD_SIZE 4u

enum operation { RAW, FRAMED, SAMPLES, HANG_UP, EMERGENCY_STOP, SENSE, OPERATIONS };

static uint8_t basis[2048];

static void check(bool holds)
{
    if (!holds) {
        abort();
    }
}

static void ignore_frame(void *context, const uint8_t *frame, size_t length)
{
    (void)context;
    check(length >= 2u && frame[length - 1u] == 0);
}

static void do_nothing(void *context)
{
    (void)context;
}

static void start(struct tactable_device *device)
{
    const struct tactable_configuration configuration = {
        .boot_id = BOOT_ID,
        .synthesis_rate_hz = 8000,
        .frequency_resolution_uhz = 10000,
        .frequency_minimum = 100,
        .frequency_maximum = 65535,
        .amplitude_limit = AMPLITUDE_LIMIT,
        .slew_limit_per_s = 1000,
        .number_of_actuators = ACTUATORS,
        .longest_lease_ms = 100,
        .longest_waveform_ms = 1000,
        .basis_capacity_bytes = sizeof basis,
        .basis = basis,
        .sensor_rate_mhz = 3200000,
        .sensor_greatest = 4095,
        .sensor_delay_samples = 7,
    };
    const struct tactable_hooks hooks = {NULL, ignore_frame, do_nothing, do_nothing};
    tactable_device_start(device, &configuration, &hooks);
}

static void receive_framed(struct tactable_device *device, const uint8_t *bytes, size_t length, uint64_t now_us)
{
    uint8_t body[FRAMING_BODY_BOUND + FRAMING_CHECKSUM_SIZE] = {0};
    uint8_t frame[FRAMING_FRAME_BOUND];
    const size_t size = length < FRAMING_BODY_BOUND ? length : FRAMING_BODY_BOUND;
    memcpy(body, bytes, size);
    if (size >= 2u && body[0] >= TACTABLE_HELLO_REQ_TYPE && body[0] <= TACTABLE_ACCELERATION_TYPE) {
        tactable_device_receive(device, frame, framing_encode(body, size, frame), now_us);
    }
}

static void check_laws(struct tactable_device *device)
{
    if (device->state == TACTABLE_DEVICE_STATE_IDLE || device->state == TACTABLE_DEVICE_STATE_LATCHED) {
        check(!channels_are_driving(&device->channels));
    }
    for (unsigned i = 0; i < SAMPLES_A_RECORD; i++) {
        int16_t displacements[ACTUATORS];
        tactable_device_sample(device, displacements);
        for (unsigned actuator = 0; actuator < ACTUATORS; actuator++) {
            check(abs(displacements[actuator]) <= GREATEST_OUTPUT);
        }
    }
}

static void run(struct tactable_device *device, enum operation operation, const uint8_t *bytes, size_t size, uint64_t now_us)
{
    switch (operation) {
    case RAW:
        tactable_device_receive(device, bytes, size, now_us);
        break;
    case FRAMED:
        receive_framed(device, bytes, size, now_us);
        break;
    case HANG_UP:
        tactable_device_hang_up(device, now_us);
        break;
    case EMERGENCY_STOP:
        tactable_device_emergency_stop(device, now_us);
        break;
    case SENSE:
        for (size_t i = 0; i + 1u < size; i += 2u) {
            tactable_device_sense(device, (int16_t)get_u16(bytes + i));
        }
        tactable_device_miss(device, (uint32_t)size % 2u);
        check(sense_waiting(&device->sense) <= SENSE_RECORDS);
        check(device->sense.is_on || sense_waiting(&device->sense) == 0);
        tactable_device_advance(device, now_us);
        break;
    default:
        tactable_device_advance(device, now_us);
        break;
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t length);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t length)
{
    static struct tactable_device device;
    uint64_t now_us = 0;
    start(&device);
    while (length >= HEAD_SIZE) {
        const enum operation operation = (enum operation)(data[0] % OPERATIONS);
        now_us += (uint64_t)get_u16(data + 1) * TIME_STEP_US;
        const size_t rest = length - HEAD_SIZE;
        const size_t size = data[3] < rest ? data[3] : rest;
        run(&device, operation, data + HEAD_SIZE, size, now_us);
        check_laws(&device);
        data += HEAD_SIZE + size;
        length -= HEAD_SIZE + size;
    }
    return 0;
}
