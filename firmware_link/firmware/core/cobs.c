#include "cobs.h"

#define LONGEST_RUN 0xffu

size_t cobs_encode(const uint8_t *bytes, size_t length, uint8_t *out)
{
    size_t code_at = 0, written = 1;
    uint8_t code = 1;
    for (size_t i = 0; i < length; i++) {
        /* A full run is closed only when a byte follows it, so that 254 bytes grow by one byte only. */
        if (code == LONGEST_RUN) {
            out[code_at] = code;
            code_at = written++;
            code = 1;
        }
        if (bytes[i] != 0) {
            out[written++] = bytes[i];
            code++;
        } else {
            out[code_at] = code;
            code_at = written++;
            code = 1;
        }
    }
    out[code_at] = code;
    return written;
}

bool cobs_decode(uint8_t *bytes, size_t *length)
{
    size_t read = 0, written = 0;
    while (read < *length) {
        const size_t code = bytes[read++];
        if (read + code - 1u > *length) {
            return false;
        }
        for (size_t i = 1; i < code; i++) {
            bytes[written++] = bytes[read++];
        }
        if (code != LONGEST_RUN && read < *length) {
            bytes[written++] = 0;
        }
    }
    *length = written;
    return true;
}
