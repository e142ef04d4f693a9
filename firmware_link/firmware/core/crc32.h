/* CRC-32 as zlib computes it: reflected polynomial 0xedb88320, inverted before and after. */
#ifndef TACTABLE_CRC32_H
#define TACTABLE_CRC32_H

#include <stddef.h>
#include <stdint.h>

/* CRC of the bytes, continued from the CRC of the bytes before them; 0 where there are none. */
uint32_t crc32_of(const uint8_t *bytes, size_t length, uint32_t before);

#endif
