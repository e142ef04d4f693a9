/* Bytes between an interrupt and the main loop: one side puts, the other takes, nothing is locked. */
#ifndef TACTABLE_RING_H
#define TACTABLE_RING_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* A power of two, so that the free-running indices may wrap; four of the longest frames. */
#define RING_SIZE 1024u

struct ring {
    uint8_t bytes[RING_SIZE];
    volatile uint32_t put;
    volatile uint32_t taken;
};

static inline size_t ring_room(const struct ring *ring)
{
    return RING_SIZE - (ring->put - ring->taken);
}

/* Drops the byte where there is no room: the checksum of its frame tells. */
static inline void ring_put(struct ring *ring, uint8_t byte)
{
    if (ring_room(ring) != 0) {
        ring->bytes[ring->put % RING_SIZE] = byte;
        ring->put++;
    }
}

static inline bool ring_take(struct ring *ring, uint8_t *byte)
{
    if (ring->put == ring->taken) {
        return false;
    }
    *byte = ring->bytes[ring->taken % RING_SIZE];
    ring->taken++;
    return true;
}

/* Puts all bytes or none. */
static inline void ring_put_all(struct ring *ring, const uint8_t *bytes, size_t length)
{
    if (ring_room(ring) < length) {
        return;
    }
    for (size_t i = 0; i < length; i++) {
        ring_put(ring, bytes[i]);
    }
}

static inline size_t ring_take_up_to(struct ring *ring, uint8_t *bytes, size_t room)
{
    size_t taken = 0;
    while (taken < room && ring_take(ring, &bytes[taken])) {
        taken++;
    }
    return taken;
}

#endif
