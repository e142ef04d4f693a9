/* Memory for waveforms: the bank that is held and, where there is room, the next one in transfer. A copy of a step of
 * the transfer changes nothing.
 *
 * Bytes: `sample_rate_hz u16, waveforms u16`, `samples u16` of each, then the int16 samples of all actuators together.
 */
#ifndef TACTABLE_BANK_H
#define TACTABLE_BANK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "tactable_protocol.h"

struct bank {
    uint8_t *bytes;
    uint32_t capacity_bytes;
    uint32_t longest_waveform_us;
    uint32_t held_hash; /* 0: none */
    uint32_t held_at;   /* offset of its first byte */
    uint32_t held_size;
    bool is_transferring;
    uint32_t transfer_at;
    uint32_t transfer_hash;
    uint32_t transfer_size;
    uint32_t taken; /* bytes of the transfer so far */
    uint8_t number_of_actuators;
};

/* One waveform of the bank that is held. */
struct waveform {
    const uint8_t *samples; /* int16 of all actuators for one instant together */
    uint32_t length_us;     /* rounded up */
    uint16_t number_of_samples;
    uint16_t sample_rate_hz;
};

/* Without room for both, the bank that is held is forgotten if it may be. The transfer's bytes are not touched yet. */
enum tactable_result bank_begin(struct bank *bank, const struct tactable_bank_begin *message, bool may_forget);
enum tactable_result bank_take(struct bank *bank, const struct tactable_bank_chunk *message);
enum tactable_result bank_commit(struct bank *bank, const struct tactable_bank_commit *message);

/* Forgets an unfinished transfer; the bank that is held stays. */
void bank_end_transfer(struct bank *bank);

/* Looks a waveform up; false where no bank is held or it has none of this index. */
bool bank_waveform(const struct bank *bank, uint16_t index, struct waveform *waveform);

#endif
