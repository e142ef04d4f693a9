/* The bank of waveforms that the host hands over, which the device remembers between drives. */
#ifndef TACTABLE_MEMORY_H
#define TACTABLE_MEMORY_H

#include <stdint.h>

#include "outcome.h"
#include "state.h"

/* BANK_*, by their bodies: acknowledged, and a new bank told by LOG. */
enum outcome memory_keep(struct tactable_device *device, const uint8_t *body, uint8_t sequence);

#endif
