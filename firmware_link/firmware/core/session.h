/* Who may drive: greeting, arming, latching, and the way of each message to what it is for. */
#ifndef TACTABLE_SESSION_H
#define TACTABLE_SESSION_H

#include <stdint.h>

#include "state.h"

/* Acts on a body that the framing accepted, and counts what became of it. */
void session_act_on(struct tactable_device *device, const uint8_t *body);

/* Silence, in a new state. */
void session_silence(struct tactable_device *device, enum tactable_device_state state);

/* Silence, and nothing more without a new handshake. */
void session_latch(struct tactable_device *device, enum tactable_fault_code fault);

#endif
