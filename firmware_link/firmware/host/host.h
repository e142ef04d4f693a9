/* The core as a shared library of this machine: a device with virtual time, for `tactable emulate --core` and the tests. */
#ifndef TACTABLE_HOST_H
#define TACTABLE_HOST_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* As in DeviceConfiguration in firmware_link/emulator/firmware.py. */
enum host_option {
    HOST_BOOT_ID,
    HOST_NUMBER_OF_ACTUATORS,
    HOST_LONGEST_LEASE_MS,
    HOST_FREQUENCY_RESOLUTION_UHZ,
    HOST_FREQUENCY_MINIMUM,
    HOST_FREQUENCY_MAXIMUM,
    HOST_AMPLITUDE_LIMIT,
    HOST_SLEW_LIMIT_PER_S,
    HOST_SYNTHESIS_RATE_HZ,
    HOST_BANK_CAPACITY_BYTES,
    HOST_LONGEST_WAVEFORM_MS,
    HOST_LONGEST_DRIVE_S,
    HOST_OPTIONS,
};

struct host;

/* A device that has just booted; NULL for options that are out of their range or where memory is short. There is a
 * full scale for each actuator; samples that are not kept are computed all the same. */
struct host *host_open(const uint32_t options[HOST_OPTIONS], const uint32_t *full_scales_pm, bool keeps_samples);
void host_close(struct host *host);

/* Time goes up to `now_us`, with every sample before it; then bytes come, or the line goes. */
void host_receive(struct host *host, const uint8_t *bytes, size_t length, uint64_t now_us);
void host_advance(struct host *host, uint64_t now_us);
void host_hang_up(struct host *host, uint64_t now_us);

/* What the device has sent since the last call, at most `room` bytes. */
size_t host_take_sent(struct host *host, uint8_t *bytes, size_t room);

/* The samples since the last call, at most `room` instants of all actuators; `room` 0 asks how many there are. */
size_t host_take_samples(struct host *host, int16_t *samples, size_t room);

uint64_t host_next_deadline_us(const struct host *host);
uint8_t host_state(const struct host *host);
bool host_allows_high_voltage(const struct host *host);

/* The amplitude of each oscillator as it is and as it is aimed at, full scale/65535 rounded up. */
void host_amplitudes(const struct host *host, uint16_t *amplitudes, uint16_t *targets);

/* applied, stale, refused, trips; then ok, crc, framing, length, overrun. */
void host_counters(const struct host *host, uint32_t counters[9]);

#endif
