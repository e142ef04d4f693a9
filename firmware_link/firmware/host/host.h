/* The core as a shared library: a device with virtual time, for `tactable emulate --core` and the tests. */
#ifndef TACTABLE_HOST_H
#define TACTABLE_HOST_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* As in DeviceConfiguration in firmware_link/emulator/device_state.py. */
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
    HOST_BASIS_CAPACITY_BYTES,
    HOST_LONGEST_WAVEFORM_MS,
    HOST_LONGEST_DRIVE_S,
    HOST_BOARD,
    HOST_SENSOR_RATE_MHZ,
    HOST_SENSOR_SCALE_NM_PER_S2,
    HOST_SENSOR_GREATEST,
    HOST_ELECTRODE_BIAS,
    HOST_OPTIONS,
};

struct host;

/* Creates a device that has just booted; NULL for options out of their range, or without memory. There is a full scale
 * for each actuator. Samples are computed even if they are not kept. */
struct host *host_open(const uint32_t options[HOST_OPTIONS], const uint32_t *full_scales_pm, bool keeps_samples);
void host_close(struct host *host);

/* Let time pass up to `now_us`, with every sample before it; then take bytes, or a hang-up of the line. */
void host_receive(struct host *host, const uint8_t *bytes, size_t length, uint64_t now_us);
void host_advance(struct host *host, uint64_t now_us);
void host_hang_up(struct host *host, uint64_t now_us);

/* A sample of the accelerometer now, as a board gives it; or one of before, with its displacements and its instant. */
void host_sense(struct host *host, int16_t acceleration);
void host_sense_at(struct host *host, int16_t acceleration, const int16_t *displacements, uint32_t synthesis_sample);
bool host_senses(const struct host *host);

/* Takes what the device has sent since the last call, at most `room` bytes. */
size_t host_take_sent(struct host *host, uint8_t *bytes, size_t room);

/* Takes the samples since the last call, at most `room` instants of all actuators; `room` 0 asks for their number. */
size_t host_take_samples(struct host *host, int16_t *samples, size_t room);

/* Turns the displacements of one instant into the outputs that a board sends for them. */
void host_linearise(const struct host *host, int16_t *displacements);

uint64_t host_next_deadline_us(const struct host *host);
uint8_t host_state(const struct host *host);
bool host_allows_high_voltage(const struct host *host);

/* Amplitude of each oscillator now, and its target, in full scale/65535 rounded up. */
void host_amplitudes(const struct host *host, uint16_t *amplitudes, uint16_t *targets);

/* applied, stale, refused, trips; then ok, crc, framing, length, overrun. */
void host_counters(const struct host *host, uint32_t counters[9]);

#endif
