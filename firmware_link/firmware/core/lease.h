/* Lease: which frames are fresh, until when they let a drive live, and when a silent host disarms the device. */
#ifndef TACTABLE_LEASE_H
#define TACTABLE_LEASE_H

#include <stdbool.h>
#include <stdint.h>

/* Nothing fresh for this long: disarmed until a new handshake. Not configurable: it can't be switched off. */
#define LEASE_DISARM_US 250000u

struct lease {
    uint64_t armed_us;   /* what ARM allows; how far the clocks may be apart */
    uint64_t drive_us;   /* what the last SET asked, within that */
    uint64_t fresh_us;   /* when the last fresh frame came */
    uint64_t renewed_us; /* when the drive was applied or renewed */
    uint8_t fresh_sequence;
};

/* Whether a frame is neither old nor a copy: near by the clock, and later in sequence than what came shortly before. */
bool lease_is_fresh(const struct lease *lease, uint16_t clock_reference, uint8_t sequence, uint64_t now_us);

/* Notes a fresh frame. */
void lease_refresh(struct lease *lease, uint8_t sequence, uint64_t now_us);

uint64_t lease_end_us(const struct lease *lease);
uint64_t lease_watchdog_end_us(const struct lease *lease);

#endif
