/* Session: greeting, arming, latching, and the dispatch of each message to its handler. */
#ifndef TACTABLE_SESSION_H
#define TACTABLE_SESSION_H

#include <stdint.h>

#include "state.h"

/* Acts on a body that the framing accepted, and counts the outcome. */
void session_act_on(struct tactable_device *device, const uint8_t *body);

/* Ramps to silence and enters a state. */
void session_silence(struct tactable_device *device, enum tactable_device_state state);

/* Ramps to silence and latches: nothing moves until a new handshake. FAULT reports the reason. */
void session_latch(struct tactable_device *device, enum tactable_fault_code fault);

#endif
