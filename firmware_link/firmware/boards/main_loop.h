/* The two activities of a board: turns of the main loop, and samples in an interrupt. */
#ifndef TACTABLE_MAIN_LOOP_H
#define TACTABLE_MAIN_LOOP_H

#include "device.h"

/* The one device of this board, to be read only. */
extern struct tactable_device the_device;

void main_loop_start(void);

/* One turn: receive, act, send; called for ever. */
void main_loop_turn(void);

/* One sample; the board's interrupt calls it at the synthesis rate. */
void main_loop_sample(void);

#endif
