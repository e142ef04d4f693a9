/* Boot id: a number that differs from boot to boot, on a chip with or without a random number generator. */
#ifndef TACTABLE_BOOT_ID_H
#define TACTABLE_BOOT_ID_H

#include <stdint.h>

/* Made from a random number, where the chip has one, and a count of boots in memory that a reset leaves alone. */
uint32_t next_boot_id(uint32_t chance);

#endif
