/* What sounds: drives and waveforms that replace each other, and silence. */
#ifndef TACTABLE_DRIVE_H
#define TACTABLE_DRIVE_H

#include <stdint.h>

#include "outcome.h"
#include "state.h"

/* Act on the body of a SET, PLAY or KEEPALIVE: refused unless the device is armed, stale unless the frame is fresh. */
enum outcome drive_set(struct tactable_device *device, const uint8_t *body, uint8_t sequence);
enum outcome drive_play(struct tactable_device *device, const uint8_t *body, uint8_t sequence);
enum outcome drive_keep_alive(struct tactable_device *device, const uint8_t *body, uint8_t sequence);

/* Ramps every amplitude to zero at the slew limit. */
void drive_silence(struct tactable_device *device);

/* Prepares the memory of a transfer for new bytes: a waveform of an earlier basis may still sound from there. */
void drive_release_transfer(struct tactable_device *device);

#endif
