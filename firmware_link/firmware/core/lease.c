#include "lease.h"

#include "tactable_protocol.h"

#define HALF_SPAN (TACTABLE_CLOCK_REFERENCE_SPAN / 2u)
/* A sequence is one byte: half of its numbers are ahead. */
#define GREATEST_STEP 127u

/* How far a reference is from the device's clock, either way. */
static uint64_t distance_us(uint16_t clock_reference, uint64_t now_us)
{
    const uint16_t age = (uint16_t)(now_us / TACTABLE_CLOCK_REFERENCE_US - clock_reference);
    const uint32_t distance = age < HALF_SPAN ? age : TACTABLE_CLOCK_REFERENCE_SPAN - age;
    return (uint64_t)distance * TACTABLE_CLOCK_REFERENCE_US;
}

bool lease_is_fresh(const struct lease *lease, uint16_t clock_reference, uint8_t sequence, uint64_t now_us)
{
    if (distance_us(clock_reference, now_us) > lease->armed_us) {
        return false;
    }
    /* A frame may seem up to one lease young, so its copy can pass the clock for two leases. */
    const bool is_held = now_us <= lease->fresh_us + 2u * lease->armed_us;
    const uint8_t step = (uint8_t)(sequence - lease->fresh_sequence);
    return !is_held || (step >= 1u && step <= GREATEST_STEP);
}

void lease_refresh(struct lease *lease, uint8_t sequence, uint64_t now_us)
{
    lease->fresh_us = now_us;
    lease->fresh_sequence = sequence;
}

uint64_t lease_end_us(const struct lease *lease)
{
    return lease->renewed_us + lease->drive_us;
}

uint64_t lease_watchdog_end_us(const struct lease *lease)
{
    return lease->fresh_us + LEASE_DISARM_US;
}
