/* What sounds: drives and waveforms that replace each other, and silence. */
#ifndef TACTABLE_DRIVE_H
#define TACTABLE_DRIVE_H

#include <stdint.h>

#include "outcome.h"
#include "state.h"

/* SET, PLAY and KEEPALIVE, by their bodies: fresh ones hold a device that is armed. */
enum outcome drive_set(struct tactable_device *device, const uint8_t *body, uint8_t sequence);
enum outcome drive_play(struct tactable_device *device, const uint8_t *body, uint8_t sequence);
enum outcome drive_keep_alive(struct tactable_device *device, const uint8_t *body, uint8_t sequence);

/* Every amplitude to zero by the slew. */
void drive_silence(struct tactable_device *device);

/* The bytes of the transfer are about to change, under a waveform of an earlier bank that may still sound. */
void drive_release_transfer(struct tactable_device *device);

#endif
