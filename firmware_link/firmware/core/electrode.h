/* Linearisation of an electrostatic actuator of one electrode: voltages whose square follows the displacement. */
#ifndef TACTABLE_ELECTRODE_H
#define TACTABLE_ELECTRODE_H

#include <stdint.h>

/* The output for a displacement (32767 = full scale): the voltage of the electrode, of the greatest one / 65535, less
 * 32768. `bias` is the voltage at rest in the same units, above 0. No displacement needs more than the greatest voltage or
 * less than none. */
int16_t electrode_output(uint16_t bias, int16_t displacement);

#endif
