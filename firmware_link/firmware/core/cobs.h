/* Consistent overhead byte stuffing (COBS): any bytes to bytes without a zero, and back. */
#ifndef TACTABLE_COBS_H
#define TACTABLE_COBS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Greatest stuffed size of `length` bytes: one more, and one for each 254. */
#define COBS_BOUND(length) ((length) + 1u + (length) / 254u)

/* Stuffs into `out`, which holds COBS_BOUND(length); returns the number of bytes written. */
size_t cobs_encode(const uint8_t *bytes, size_t length, uint8_t *out);

/* Unstuffs in place. Returns false, and leaves `bytes` undefined, for bytes that cobs_encode never makes. `bytes` must
 * not contain a zero. */
bool cobs_decode(uint8_t *bytes, size_t *length);

#endif
