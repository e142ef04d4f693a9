/* Memory for the basis of clicks: the one that is held and, where there is room, the next one in transfer. A copy of a
 * step of the transfer changes nothing.
 *
 * Bytes: `sample_rate_hz u16, sets u16`, `samples u16, functions u16` of each set, then set by set the actuator u8 of
 * each function and the int16 samples, those of all functions for one instant together.
 */
#ifndef TACTABLE_BASIS_H
#define TACTABLE_BASIS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "tactable_protocol.h"

/* The place of one basis, always within the memory: it is set as a whole, once everything has been checked. */
struct basis_place {
    uint32_t hash; /* 0: there is none */
    uint32_t at;   /* offset of its first byte */
    uint32_t size;
};

struct basis {
    uint8_t *bytes;
    uint32_t capacity_bytes;
    uint32_t longest_waveform_us;
    struct basis_place held;
    struct basis_place transfer;
    uint32_t taken; /* bytes of the transfer so far */
    uint8_t number_of_actuators;
};

/* One set of the basis that is held. */
struct basis_set {
    const uint8_t *actuators; /* of each function */
    const uint8_t *samples;   /* int16 of all functions for one instant together */
    uint32_t length_us;       /* of a click, rounded up */
    uint16_t number_of_samples;
    uint16_t sample_rate_hz;
    uint8_t number_of_functions;
};

/* Without room for both, the basis that is held is forgotten if it may be. The transfer's bytes are not touched yet. A
 * refusal changes nothing, also not of a transfer under way. */
enum tactable_result basis_begin(struct basis *basis, const struct tactable_basis_begin *message, bool may_forget);
enum tactable_result basis_take(struct basis *basis, const struct tactable_basis_chunk *message);
enum tactable_result basis_commit(struct basis *basis, const struct tactable_basis_commit *message);

/* Forgets an unfinished transfer; the basis that is held stays. */
void basis_end_transfer(struct basis *basis);

/* Looks a set up; false where no basis is held or it has none of this index. */
bool basis_find_set(const struct basis *basis, uint8_t index, struct basis_set *set);

#endif
