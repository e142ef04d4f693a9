/* The device: bytes and time in, bytes and samples out; no allocation, no clock and no hardware of its own.
 *
 * One activity calls everything but the last three functions, which one interrupt may call between `release_samples` and
 * `hold_samples`. Times are microseconds since boot and must not run backwards.
 */
#ifndef TACTABLE_DEVICE_H
#define TACTABLE_DEVICE_H

#include "state.h"

/* Initialises a device that has just booted; it is idle. */
void tactable_device_start(
    struct tactable_device *device, const struct tactable_configuration *configuration, const struct tactable_hooks *hooks);

/* Takes bytes that came at `now_us`. */
void tactable_device_receive(struct tactable_device *device, const uint8_t *bytes, size_t length, uint64_t now_us);

/* Lets time pass. */
void tactable_device_advance(struct tactable_device *device, uint64_t now_us);

/* BREAK on the line: ramps to zero and latches in any state. */
void tactable_device_emergency_stop(struct tactable_device *device, uint64_t now_us);

/* The host is gone: DTR dropped, USB suspended. Latches a device that is armed. */
void tactable_device_hang_up(struct tactable_device *device, uint64_t now_us);

/* Time at which the device acts by itself next; NEVER_US while it waits for a host. */
uint64_t tactable_device_next_deadline_us(const struct tactable_device *device);

/* Whether the supply may be on: armed, or disarmed and still ramping, for 100 ms at most. */
bool tactable_device_allows_high_voltage(const struct tactable_device *device);

/* The displacements of all actuators for the next sample, 32767 = full scale. */
void tactable_device_sample(struct tactable_device *device, int16_t *displacements);

/* Turns the displacements of one sample into outputs, in place: voltages for a board that linearises (electrode.h). */
void tactable_device_linearise(const struct tactable_device *device, int16_t *displacements);

/* Takes a sample of the board's accelerometer, in counts, that came since the last tactable_device_sample(): it belongs to
 * the displacements that this returned, or to those of `sensor_delay_samples` before. It neither waits nor allocates. */
void tactable_device_sense(struct tactable_device *device, int16_t acceleration);

#endif
