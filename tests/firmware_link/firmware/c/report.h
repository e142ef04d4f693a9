/* Report of an emulated board, as text on a second line: what it really did, for tests, beside what it says by protocol.
 *
 * One line each millisecond, in hexadecimal: boot id; device time, and when the drive was last set or renewed, in us;
 * state, high voltage, greatest |output| of each actuator since the line before. Two letters cause faults that only the
 * hardware watchdog can mend: `w` wedges the main loop, `s` stops the samples.
 */
#ifndef TACTABLE_REPORT_H
#define TACTABLE_REPORT_H

#include <stdbool.h>
#include <stdint.h>

/* Of the last line; a debugger may stop the image at report_done(), once for each. */
extern uint32_t report_time_us;
void report_done(void) __attribute__((noinline));

/* From board_write_outputs(). */
void report_outputs(const int16_t *displacements);

/* From board_high_voltage(). */
void report_high_voltage(bool is_on);

/* Waits about as long as a sample lasts, awake and off the bus. The clock of a QEMU that sleeps jumps when the machine
 * under it is late, and samples are lost; one that asks its devices all the time keeps QEMU itself from its lines. */
void report_wait(void);

/* From board_end_turn(), with what came on the second line, 0 for nothing; `put` writes one character. */
void report_turn(uint8_t command, void (*put)(uint8_t character));

#endif
