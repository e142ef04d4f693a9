/* Frames `COBS(body, CRC-32), 0x00`: bytes to bodies and bodies to frames, in a buffer of fixed size. */
#ifndef TACTABLE_FRAMING_H
#define TACTABLE_FRAMING_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "cobs.h"
#include "limits.h"
#include "tactable_protocol.h"

#define FRAMING_CHECKSUM_SIZE 4u
#define FRAMING_BODY_BOUND TACTABLE_BODY_BOUND(TACTABLE_ACTUATORS)
/* Greatest size of a frame with its delimiter. */
#define FRAMING_FRAME_BOUND (COBS_BOUND(FRAMING_BODY_BOUND + FRAMING_CHECKSUM_SIZE) + 1u)

/* What a received byte completed. */
enum framing_item { FRAMING_NOTHING, FRAMING_BODY, FRAMING_EMERGENCY_STOP };

/* Frames accepted, and refused by reason, since boot. */
struct framing_counters {
    uint32_t ok;
    uint32_t crc;
    uint32_t framing;
    uint32_t length;
    uint32_t overrun;
};

/* Decoder of one line; it is in step again at the next delimiter after any damage. */
struct framing {
    struct framing_counters counters;
    uint8_t buffer[FRAMING_FRAME_BOUND];
    size_t held;
    size_t length; /* of the last body */
    size_t capacity;
    uint8_t number_of_actuators;
    uint8_t delimiters_in_a_row;
    bool is_discarding;
};

/* A decoder for a device of at most TACTABLE_ACTUATORS. */
void framing_start(struct framing *framing, uint8_t number_of_actuators);

/* Takes one byte. After FRAMING_BODY the body is the first `length` bytes of `buffer`, until the next byte. */
enum framing_item framing_take(struct framing *framing, uint8_t byte);

/* Frame of a body of a known type; `body` has room for the checksum behind it, `frame` for COBS_BOUND of both and the
 * delimiter. Returns the length of the frame. */
size_t framing_encode(uint8_t *body, size_t length, uint8_t *frame);

#endif
