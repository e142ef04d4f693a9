#include "boot_id.h"

#include "bytes.h"
#include "crc32.h"

/* Where a reset leaves memory alone: each linker script has its own name for it. */
#ifndef BOOT_COUNT_SECTION
#define BOOT_COUNT_SECTION ".noinit"
#endif

static uint32_t boots __attribute__((section(BOOT_COUNT_SECTION)));

uint32_t next_boot_id(uint32_t chance)
{
    uint8_t bytes[8];
    boots++;
    put_u32(put_u32(bytes, chance), boots);
    /* Two counts with the same random number never have the same CRC: CRC-32 is injective on 32 bits. */
    return crc32_of(bytes, sizeof bytes, 0);
}
