/* Consistent overhead byte stuffing: any bytes to bytes without a zero, and back. */
#ifndef TACTABLE_COBS_H
#define TACTABLE_COBS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Bytes that stuffing makes of `length` at most: one more, and one for each 254. */
#define COBS_BOUND(length) ((length) + 1u + (length) / 254u)

/* Stuffs into `out`, which holds COBS_BOUND(length); returns the number of bytes written. */
size_t cobs_encode(const uint8_t *bytes, size_t length, uint8_t *out);

/* Unstuffs in place; false, with `bytes` spoilt, for what cobs_encode never makes. `bytes` has no zero in it. */
bool cobs_decode(uint8_t *bytes, size_t *length);

#endif
