/* The state that all parts of a device share: what the board is, the time, what is allowed, and each part's own data.
 *
 * The modules above it (reports, drive, memory, session, device) are functions on this one structure, each including
 * only modules below it; the README has the order.
 */
#ifndef TACTABLE_STATE_H
#define TACTABLE_STATE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "basis.h"
#include "channels.h"
#include "framing.h"
#include "lease.h"
#include "limits.h"
#include "player.h"
#include "sense.h"
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
    uint32_t basis_capacity_bytes; /* 0: no waveforms */
    uint8_t *basis;                /* basis_capacity_bytes of memory */
    uint32_t full_scales_pm[TACTABLE_ACTUATORS];
    uint16_t electrode_bias; /* voltage at rest, of the greatest one / 65535; 0: outputs are displacements */
    uint32_t sensor_rate_mhz; /* nominal; 0: no accelerometer */
    uint32_t sensor_scale_nm_per_s2;
    uint16_t sensor_greatest;     /* count at the end of its range */
    uint8_t sensor_delay_samples; /* of the synthesis, from the motion to its sample; below SENSE_HISTORY */
};

#define TACTABLE_LONGEST_LEASE_MS 100u

/* Functions that the board gives to the core. `send` takes a whole frame or drops it. */
struct tactable_hooks {
    void *context;
    void (*send)(void *context, const uint8_t *frame, size_t length);
    void (*hold_samples)(void *context);
    void (*release_samples)(void *context);
};

/* Frames by their outcome, and leases that ended, since boot. */
struct tactable_counters {
    uint32_t applied;
    uint32_t stale;
    uint32_t refused;
    uint32_t trips;
};

/* What the device says (reports.c): frames are numbered, periodic ones have their times. */
struct reports {
    uint64_t status_allowed_us; /* not before: a new drive is reported soon, but not at the cost of the line */
    uint64_t fault_due_us;      /* NEVER_US unless one waits for its ACK */
    uint64_t fault_time_us;
    uint64_t log_allowed_us;
    uint64_t applied_time_us;
    uint8_t sequence;
    uint8_t fault_sequence;
    uint8_t applied_sequence;
    enum tactable_fault_code fault;
    bool was_greeted;
};

struct tactable_device {
    struct tactable_configuration configuration;
    struct tactable_hooks hooks;
    uint64_t now_us;
    enum tactable_device_state state;
    uint64_t status_due_us; /* NEVER_US until the first greeting */
    struct tactable_counters counters;
    struct framing framing;
    struct lease lease;
    struct channels channels;
    struct basis basis;
    struct player player;
    struct reports reports;
    struct synthesis synthesis;
    struct sense sense;
    struct click click; /* the newest; too large for the stack of small boards */
    uint16_t high_voltage_dv;
    uint16_t slew_per_s;
    uint16_t slew_to_come_per_s; /* from the last ARM; in force from the next SET or PLAY on */
    uint64_t driving_since_us;
    uint64_t longest_drive_us; /* NEVER_US: no limit */
    uint64_t disarmed_us;
};

/* Whether drives are allowed. */
bool state_is_armed(const struct tactable_device *device);

/* Whether the board has an accelerometer, and a frame room for a sample of it. */
bool state_has_accelerometer(const struct tactable_device *device);

/* Changes the state; STATUS says so at once. */
void state_enter(struct tactable_device *device, enum tactable_device_state state);

/* STATUS is due no later than this. */
void state_want_status(struct tactable_device *device, uint64_t due_us);

#endif
