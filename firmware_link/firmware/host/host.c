#include "host.h"

#include <stdlib.h>
#include <string.h>

#include "device.h"
#include "device_time.h"

struct bytes_held {
    uint8_t *bytes;
    size_t length;
    size_t room;
};

struct host {
    struct tactable_device device;
    struct bytes_held sent;
    struct bytes_held samples;
    uint64_t sample;
    bool keeps_samples;
    uint8_t *basis;
};

static void append(struct bytes_held *held, const void *bytes, size_t length)
{
    if (held->length + length > held->room) {
        held->room = 2u * (held->length + length);
        held->bytes = realloc(held->bytes, held->room);
        if (held->bytes == NULL) {
            abort();
        }
    }
    memcpy(held->bytes + held->length, bytes, length);
    held->length += length;
}

static size_t take(struct bytes_held *held, void *out, size_t room)
{
    const size_t length = held->length < room ? held->length : room;
    if (length != 0) {
        memcpy(out, held->bytes, length);
        memmove(held->bytes, held->bytes + length, held->length - length);
        held->length -= length;
    }
    return length;
}

static void keep_sent(void *context, const uint8_t *frame, size_t length)
{
    append(&((struct host *)context)->sent, frame, length);
}

static void do_nothing(void *context)
{
    (void)context;
}

static bool are_valid(const uint32_t options[HOST_OPTIONS])
{
    static const uint32_t greatest[HOST_OPTIONS] = {
        UINT32_MAX, TACTABLE_ACTUATORS, TACTABLE_LONGEST_LEASE_MS, UINT16_MAX, UINT16_MAX, UINT16_MAX, UINT16_MAX,
        UINT16_MAX, 10000000u, 1u << 30, UINT16_MAX, UINT8_MAX, UINT16_MAX, UINT32_MAX, UINT32_MAX, UINT16_MAX,
        UINT16_MAX,
    };
    for (size_t i = 0; i < HOST_OPTIONS; i++) {
        if (options[i] > greatest[i]) {
            return false;
        }
    }
    return options[HOST_NUMBER_OF_ACTUATORS] != 0 && options[HOST_LONGEST_LEASE_MS] != 0
        && options[HOST_SYNTHESIS_RATE_HZ] != 0 && options[HOST_SLEW_LIMIT_PER_S] != 0;
}

struct host *host_open(const uint32_t options[HOST_OPTIONS], const uint32_t *full_scales_pm, bool keeps_samples)
{
    struct host *host = are_valid(options) ? calloc(1, sizeof *host) : NULL;
    const uint32_t capacity_bytes = options[HOST_BASIS_CAPACITY_BYTES];
    /* No byte more than the core may use: a sanitizer sees the next one. */
    uint8_t *basis = host == NULL ? NULL : malloc(capacity_bytes != 0 ? capacity_bytes : 1u);
    if (basis == NULL) {
        free(host);
        return NULL;
    }
    host->basis = basis;
    host->keeps_samples = keeps_samples;
    struct tactable_configuration configuration = {
        .boot_id = options[HOST_BOOT_ID],
        .number_of_actuators = (uint8_t)options[HOST_NUMBER_OF_ACTUATORS],
        .longest_lease_ms = (uint8_t)options[HOST_LONGEST_LEASE_MS],
        .frequency_resolution_uhz = (uint16_t)options[HOST_FREQUENCY_RESOLUTION_UHZ],
        .frequency_minimum = (uint16_t)options[HOST_FREQUENCY_MINIMUM],
        .frequency_maximum = (uint16_t)options[HOST_FREQUENCY_MAXIMUM],
        .amplitude_limit = (uint16_t)options[HOST_AMPLITUDE_LIMIT],
        .slew_limit_per_s = (uint16_t)options[HOST_SLEW_LIMIT_PER_S],
        .synthesis_rate_hz = options[HOST_SYNTHESIS_RATE_HZ],
        .basis_capacity_bytes = capacity_bytes,
        .basis = basis,
        .longest_waveform_ms = (uint16_t)options[HOST_LONGEST_WAVEFORM_MS],
        .longest_drive_s = (uint8_t)options[HOST_LONGEST_DRIVE_S],
        .board = (uint16_t)options[HOST_BOARD],
        .sensor_rate_mhz = options[HOST_SENSOR_RATE_MHZ],
        .sensor_scale_nm_per_s2 = options[HOST_SENSOR_SCALE_NM_PER_S2],
        .sensor_greatest = (uint16_t)options[HOST_SENSOR_GREATEST],
        .electrode_bias = (uint16_t)options[HOST_ELECTRODE_BIAS],
    };
    memcpy(configuration.full_scales_pm, full_scales_pm, options[HOST_NUMBER_OF_ACTUATORS] * sizeof *full_scales_pm);
    const struct tactable_hooks hooks = {host, keep_sent, do_nothing, do_nothing};
    tactable_device_start(&host->device, &configuration, &hooks);
    return host;
}

void host_close(struct host *host)
{
    if (host != NULL) {
        free(host->sent.bytes);
        free(host->samples.bytes);
        free(host->basis);
        free(host);
    }
}

void host_linearise(const struct host *host, int16_t *displacements)
{
    tactable_device_linearise(&host->device, displacements);
}

/* Runs every sample before `now_us`, each after what the device does by itself until then. */
static void run_samples(struct host *host, uint64_t now_us)
{
    const uint64_t rate_hz = host->device.configuration.synthesis_rate_hz;
    while (host->sample * US_PER_S < now_us * rate_hz) {
        int16_t displacements[TACTABLE_ACTUATORS];
        tactable_device_advance(&host->device, host->sample * US_PER_S / rate_hz);
        tactable_device_sample(&host->device, displacements);
        if (host->keeps_samples) {
            append(&host->samples, displacements, sizeof *displacements * host->device.configuration.number_of_actuators);
        }
        host->sample++;
    }
}

void host_receive(struct host *host, const uint8_t *bytes, size_t length, uint64_t now_us)
{
    run_samples(host, now_us);
    tactable_device_receive(&host->device, bytes, length, now_us);
}

void host_advance(struct host *host, uint64_t now_us)
{
    run_samples(host, now_us);
    tactable_device_advance(&host->device, now_us);
}

void host_hang_up(struct host *host, uint64_t now_us)
{
    run_samples(host, now_us);
    tactable_device_hang_up(&host->device, now_us);
}

void host_sense(struct host *host, int16_t acceleration)
{
    tactable_device_sense(&host->device, acceleration);
}

void host_sense_at(struct host *host, int16_t acceleration, const int16_t *displacements, uint32_t synthesis_sample)
{
    sense_take(&host->device.sense, acceleration, displacements, synthesis_sample);
}

bool host_senses(const struct host *host)
{
    return host->device.sense.is_on;
}

size_t host_take_sent(struct host *host, uint8_t *bytes, size_t room)
{
    return take(&host->sent, bytes, room);
}

size_t host_take_samples(struct host *host, int16_t *samples, size_t room)
{
    const size_t instant_size = sizeof(int16_t) * host->device.configuration.number_of_actuators;
    if (room == 0) {
        return host->samples.length / instant_size;
    }
    return take(&host->samples, samples, room * instant_size) / instant_size;
}

uint64_t host_next_deadline_us(const struct host *host)
{
    return tactable_device_next_deadline_us(&host->device);
}

uint8_t host_state(const struct host *host)
{
    return (uint8_t)host->device.state;
}

bool host_allows_high_voltage(const struct host *host)
{
    return tactable_device_allows_high_voltage(&host->device);
}

static uint16_t word_of(int32_t amplitude)
{
    return (uint16_t)((amplitude + TONES_WORD_SCALE - 1) / TONES_WORD_SCALE);
}

void host_amplitudes(const struct host *host, uint16_t *amplitudes, uint16_t *targets)
{
    for (size_t i = 0; i < host->device.configuration.number_of_actuators; i++) {
        const struct tones_channel *channel = &host->device.synthesis.tones.channels[i];
        amplitudes[i] = word_of(tones_amplitude(channel));
        targets[i] = word_of(channel->target);
    }
}

void host_counters(const struct host *host, uint32_t counters[9])
{
    memcpy(counters, &host->device.counters, 4u * sizeof *counters);
    memcpy(counters + 4, &host->device.framing.counters, 5u * sizeof *counters);
}
