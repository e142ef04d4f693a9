/* BANK_* of the wire to the bank of waveforms that the device holds. */
#ifndef TACTABLE_MEMORY_H
#define TACTABLE_MEMORY_H

#include <stdint.h>

#include "outcome.h"
#include "state.h"

/* Acts on the body of a BANK_BEGIN, BANK_CHUNK or BANK_COMMIT and acknowledges it; LOG reports a new bank. */
enum outcome memory_keep(struct tactable_device *device, const uint8_t *body, uint8_t sequence);

#endif
