/* Stream: SENSE of the wire to ACCELERATION frames, for one lease at a time. */
#ifndef TACTABLE_STREAM_H
#define TACTABLE_STREAM_H

#include "outcome.h"
#include "state.h"

/* Takes a SENSE: begins, renews or ends the stream, and says what the accelerometer is. */
enum outcome stream_ask(struct tactable_device *device, const uint8_t *body);

/* Sends every frame that is whole. */
void stream_advance(struct tactable_device *device);

/* Ends the stream; what waits is sent before. */
void stream_end(struct tactable_device *device);

/* Ends the stream; what waits is forgotten. */
void stream_cut(struct tactable_device *device);

#endif
