/* ADXL345 on SPI (mode 3, 2 to 5 MHz): its start, and its samples byte by byte, a byte each turn of an interrupt.
 *
 * 3200 samples a second in full resolution, 16 g: 256 counts per g, the last bit always 0. Facts by the data sheet,
 * revision E. A sample is read within ADXL345_TURNS turns, so that many must come within 312 us.
 */
#ifndef TACTABLE_ADXL345_H
#define TACTABLE_ADXL345_H

#include <stdbool.h>
#include <stdint.h>

#define ADXL345_RATE_MHZ 3200000u
#define ADXL345_SCALE_NM_PER_S2 38307227u /* 9.80665 m/s^2 / 256 */
#define ADXL345_GREATEST 4095u
/* From the turn that sees a sample to the one that has read it: an address and six bytes. */
#define ADXL345_TURNS 7u

/* What a board gives. `exchange` sends a byte and waits for the one that comes: for the start only. */
struct adxl345_bus {
    void (*select)(bool is_selected);
    uint8_t (*exchange)(uint8_t byte);
};

/* Reading of one part; a zeroed one has none begun. */
struct adxl345 {
    uint8_t turn;
    uint8_t bytes[ADXL345_TURNS];
};

/* What a turn asks of the board: nothing, select and send `byte`, send `byte`, or let go: then `acceleration` is there. */
enum adxl345_step { ADXL345_WAIT, ADXL345_BEGIN, ADXL345_SEND, ADXL345_END };

struct adxl345_action {
    enum adxl345_step step;
    uint8_t byte;
    int16_t acceleration; /* across the chip (Z), in counts */
};

/* Sets the part up; false where none answers. */
bool adxl345_start(const struct adxl345_bus *bus);

/* One turn: `is_ready` is the pin INT1, `received` the byte that came for the one of the turn before. */
struct adxl345_action adxl345_turn(struct adxl345 *part, bool is_ready, uint8_t received);

#endif
