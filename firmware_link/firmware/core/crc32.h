/* CRC-32 as zlib computes it: reflected polynomial 0xedb88320, inverted before and after. */
#ifndef TACTABLE_CRC32_H
#define TACTABLE_CRC32_H

#include <stddef.h>
#include <stdint.h>

/* CRC of the bytes, going on from the CRC of what came before them (0: nothing did). */
uint32_t crc32_of(const uint8_t *bytes, size_t length, uint32_t before);

#endif
