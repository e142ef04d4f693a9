/* The functions that a board must define, all in one file in its folder. */
#ifndef TACTABLE_BOARD_H
#define TACTABLE_BOARD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "device.h"

/* What the board is; `boot_id` differs from boot to boot. */
void board_describe(struct tactable_configuration *configuration);

/* Outputs at rest and high voltage off, then line, clock and the interrupt that calls main_loop_sample(). */
void board_start(void);

/* Microseconds on a counter that wraps at 2^32. */
uint32_t board_time_us(void);

/* Reads the bytes that have come on the line, at most `room`; returns their number. */
size_t board_read(uint8_t *bytes, size_t room);

/* Takes a whole frame, or drops it where it does not fit: never waits. */
void board_send(const uint8_t *frame, size_t length);

/* What happened to the line since the last call: BREAK, or the host let go (DTR dropped, USB suspended). */
enum board_line { BOARD_LINE_UP, BOARD_LINE_BREAK, BOARD_LINE_HUNG_UP };
enum board_line board_line(void);

/* Keeps the sample interrupt out, from hold to release. */
void board_hold_samples(void);
void board_release_samples(void);

/* The outputs of all actuators for one sample, all at one instant: displacements, 32767 = full scale, or with an
 * `electrode_bias` the voltages of their electrodes, -32768 = none. */
void board_write_outputs(const int16_t *displacements);

/* A sample of the accelerometer, in counts, that came since the last call; false where there is none. Called before each
 * sample of the synthesis, in its interrupt: never waits. */
bool board_sense(int16_t *acceleration);

/* The enable line of the high-voltage supply; the hardware pulls it off where this is not called. */
void board_high_voltage(bool is_on);

/* The high voltage in 0.1 V; 0 on a board without a sense line. */
uint16_t board_high_voltage_dv(void);

/* Restarts the hardware watchdog. */
void board_feed_watchdog(void);

/* The end of one turn of the main loop: moves bytes that wait to be sent, and may sleep until an interrupt. */
void board_end_turn(void);

#endif
