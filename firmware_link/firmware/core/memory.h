/* BASIS_* of the wire to the basis of waveforms that the device holds. */
#ifndef TACTABLE_MEMORY_H
#define TACTABLE_MEMORY_H

#include <stdint.h>

#include "outcome.h"
#include "state.h"

/* Acts on the body of a BASIS_BEGIN, BASIS_CHUNK or BASIS_COMMIT and acknowledges it; LOG reports a new basis. */
enum outcome memory_keep(struct tactable_device *device, const uint8_t *body, uint8_t sequence);

#endif
