/* The device: bytes and time in, bytes and samples out; no allocation, no clock and no hardware of its own.
 *
 * One activity calls everything but tactable_device_sample(), which an interrupt may call between
 * `release_samples` and `hold_samples`. Times are microseconds since boot and must not run backwards.
 */
#ifndef TACTABLE_DEVICE_H
#define TACTABLE_DEVICE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "bank.h"
#include "channels.h"
#include "framing.h"
#include "lease.h"
#include "limits.h"
#include "player.h"
#include "reports.h"
#include "synthesis.h"
#include "tactable_protocol.h"

/* What the board is; everything a constant of the board but `boot_id`, which differs from boot to boot. */
struct tactable_configuration {
    uint32_t boot_id;
    uint32_t reset_cause; /* the board's own code, for LOG */
    uint32_t synthesis_rate_hz;
    uint16_t frequency_resolution_uhz;
    uint16_t frequency_minimum; /* frequency resolution */
    uint16_t frequency_maximum; /* frequency resolution */
    uint16_t amplitude_limit;   /* full scale/65535 */
    uint16_t slew_limit_per_s;  /* full scale/s, above 0 */
    uint16_t board;
    uint8_t number_of_actuators; /* 1 to TACTABLE_ACTUATORS */
    uint8_t longest_lease_ms;    /* 1 to TACTABLE_LONGEST_LEASE_MS */
    uint8_t longest_drive_s;     /* 0: no limit of its own */
    bool senses_high_voltage;
    uint16_t longest_waveform_ms;
    uint32_t bank_capacity_bytes; /* 0: no waveforms */
    uint8_t *bank;                /* bank_capacity_bytes of memory */
    uint32_t full_scales_pm[TACTABLE_ACTUATORS];
};

#define TACTABLE_LONGEST_LEASE_MS 100u

/* What the core asks of whoever runs it. `send` takes a whole frame or drops it. */
struct tactable_hooks {
    void *context;
    void (*send)(void *context, const uint8_t *frame, size_t length);
    void (*hold_samples)(void *context);
    void (*release_samples)(void *context);
};

/* Frames by what became of them, and leases that ended, since boot. */
struct tactable_counters {
    uint32_t applied;
    uint32_t stale;
    uint32_t refused;
    uint32_t trips;
};

struct tactable_device {
    struct tactable_configuration configuration;
    struct tactable_hooks hooks;
    uint64_t now_us;
    enum tactable_device_state state;
    struct tactable_counters counters;
    struct framing framing;
    struct lease lease;
    struct channels channels;
    struct bank bank;
    struct player player;
    struct reports reports;
    struct synthesis synthesis;
    uint16_t high_voltage_dv;
    uint16_t slew_per_s;
    uint16_t slew_to_come_per_s; /* what ARM allows, from the next drive on */
    uint64_t applied_time_us;
    uint64_t driving_since_us;
    uint64_t longest_drive_us; /* NEVER_US: no limit */
    uint64_t disarmed_us;
};

/* A device that has just booted, idle. */
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

/* When the device acts by itself next; NEVER_US while it waits for a host. */
uint64_t tactable_device_next_deadline_us(const struct tactable_device *device);

/* Whether the supply may be on: armed, or disarmed and still ramping, for 100 ms at most. */
bool tactable_device_allows_high_voltage(const struct tactable_device *device);

/* The displacements of all actuators for the next sample, 32767 = full scale. */
void tactable_device_sample(struct tactable_device *device, int16_t *displacements);

#endif
