/* Phase to sine by a quarter-wave table of 256 intervals and straight lines between them: within -106 dB. */
#ifndef TACTABLE_SINE_H
#define TACTABLE_SINE_H

#include <stdint.h>

/* Sine of a phase of turn/2^32, times 2^30 * 32767/32767.5. */
int32_t sine_of(uint32_t phase);

#endif
