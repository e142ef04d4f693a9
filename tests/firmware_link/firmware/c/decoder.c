/* The core's frame decoder by itself, added to the library of `make host` by the tests (compiled_decoder.py). */
#include <stdlib.h>
#include <string.h>

#include "bytes.h"
#include "framing.h"

struct decoder *decoder_open(uint8_t number_of_actuators);
void decoder_close(struct decoder *decoder);
size_t decoder_receive(struct decoder *decoder, const uint8_t *bytes, size_t length, uint8_t *out);
void decoder_counters(const struct decoder *decoder, uint32_t counters[5]);

struct decoder {
    struct framing framing;
};

struct decoder *decoder_open(uint8_t number_of_actuators)
{
    struct decoder *decoder = malloc(sizeof *decoder);
    if (decoder != NULL) {
        framing_start(&decoder->framing, number_of_actuators);
    }
    return decoder;
}

void decoder_close(struct decoder *decoder)
{
    free(decoder);
}

/* Takes bytes; writes each accepted body after its length (u16), and a length of 0 for an emergency stop. Returns the
 * number of bytes written; room for 3 times the bytes, and one frame more, is enough. */
size_t decoder_receive(struct decoder *decoder, const uint8_t *bytes, size_t length, uint8_t *out)
{
    uint8_t *end = out;
    for (size_t i = 0; i < length; i++) {
        switch (framing_take(&decoder->framing, bytes[i])) {
        case FRAMING_BODY:
            end = put_u16(end, (uint16_t)decoder->framing.length);
            memcpy(end, decoder->framing.buffer, decoder->framing.length);
            end += decoder->framing.length;
            break;
        case FRAMING_EMERGENCY_STOP:
            end = put_u16(end, 0);
            break;
        case FRAMING_NOTHING:
            break;
        }
    }
    return (size_t)(end - out);
}

/* ok, crc, framing, length, overrun. */
void decoder_counters(const struct decoder *decoder, uint32_t counters[5])
{
    memcpy(counters, &decoder->framing.counters, 5u * sizeof *counters);
}
