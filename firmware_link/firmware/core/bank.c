#include "bank.h"

#include <string.h>

#include "crc32.h"
#include "device_time.h"

#define HEAD_SIZE 4u
#define LENGTH_SIZE 2u
#define SAMPLE_SIZE 2u
#define SHORTEST_WAVEFORM 2u
/* A hash of 0 means that no bank is held. */
#define HASH_INSTEAD_OF_0 1u

static uint16_t sample_rate_hz(const uint8_t *bytes)
{
    return get_u16(bytes);
}

static uint16_t number_of_waveforms(const uint8_t *bytes)
{
    return get_u16(bytes + 2);
}

static uint16_t number_of_samples(const uint8_t *bytes, uint16_t index)
{
    return get_u16(bytes + HEAD_SIZE + LENGTH_SIZE * index);
}

static uint32_t length_us(uint16_t samples, uint16_t rate_hz)
{
    return (uint32_t)(((uint64_t)(samples - 1u) * US_PER_S + rate_hz - 1u) / rate_hz);
}

static bool is_zero(const uint8_t *bytes, size_t length)
{
    for (size_t i = 0; i < length; i++) {
        if (bytes[i] != 0) {
            return false;
        }
    }
    return true;
}

/* Whether all waveforms are within bounds, begin and end at 0, and fill the bytes exactly. */
static bool is_valid(const struct bank *bank)
{
    const uint8_t *bytes = bank->bytes + bank->transfer_at;
    const uint32_t size = bank->taken;
    if (size < HEAD_SIZE || sample_rate_hz(bytes) == 0 || number_of_waveforms(bytes) == 0) {
        return false;
    }
    const uint32_t instant_size = SAMPLE_SIZE * bank->number_of_actuators;
    uint32_t at = HEAD_SIZE + LENGTH_SIZE * number_of_waveforms(bytes);
    if (size < at) {
        return false;
    }
    for (uint16_t i = 0; i < number_of_waveforms(bytes); i++) {
        const uint16_t samples = number_of_samples(bytes, i);
        if (samples < SHORTEST_WAVEFORM || (size - at) / instant_size < samples) {
            return false;
        }
        const uint32_t last = at + (samples - 1u) * instant_size;
        if (!is_zero(bytes + at, instant_size) || !is_zero(bytes + last, instant_size)) {
            return false;
        }
        if (length_us(samples, sample_rate_hz(bytes)) > bank->longest_waveform_us) {
            return false;
        }
        at = last + instant_size;
    }
    return at == size;
}

/* Finds the place of a bank of this size beside the one that is held; false where there is no room. */
static bool find_room(struct bank *bank, uint32_t size)
{
    if (bank->held_hash == 0 || size <= bank->held_at) {
        bank->transfer_at = 0;
        return true;
    }
    bank->transfer_at = bank->held_at + bank->held_size;
    return size <= bank->capacity_bytes - bank->transfer_at;
}

enum tactable_result bank_begin(struct bank *bank, const struct tactable_bank_begin *message, bool may_forget)
{
    if (bank->is_transferring && message->bank_hash == bank->transfer_hash && message->size_bytes == bank->transfer_size) {
        return TACTABLE_RESULT_OK;
    }
    if (message->bank_hash == 0) {
        return TACTABLE_RESULT_OUT_OF_RANGE;
    }
    if (message->size_bytes > bank->capacity_bytes) {
        return TACTABLE_RESULT_NO_ROOM;
    }
    if (!find_room(bank, message->size_bytes)) {
        if (!may_forget) {
            return TACTABLE_RESULT_NO_ROOM;
        }
        bank->held_hash = 0;
        bank->transfer_at = 0;
    }
    bank->is_transferring = true;
    bank->transfer_hash = message->bank_hash;
    bank->transfer_size = message->size_bytes;
    bank->taken = 0;
    return TACTABLE_RESULT_OK;
}

enum tactable_result bank_take(struct bank *bank, const struct tactable_bank_chunk *message)
{
    if (!bank->is_transferring) {
        return TACTABLE_RESULT_WRONG_STATE;
    }
    const uint32_t offset = message->offset_bytes;
    if (offset < bank->taken && offset % TACTABLE_BANK_CHUNK_SIZE == 0) {
        return TACTABLE_RESULT_OK;
    }
    if (offset != bank->taken || offset >= bank->transfer_size) {
        return TACTABLE_RESULT_OUT_OF_RANGE;
    }
    const uint32_t rest = bank->transfer_size - offset;
    const uint32_t size = rest < TACTABLE_BANK_CHUNK_SIZE ? rest : TACTABLE_BANK_CHUNK_SIZE;
    memcpy(bank->bytes + bank->transfer_at + offset, message->data, size);
    bank->taken += size;
    return TACTABLE_RESULT_OK;
}

enum tactable_result bank_commit(struct bank *bank, const struct tactable_bank_commit *message)
{
    if (!bank->is_transferring) {
        const bool is_held = bank->held_hash != 0 && message->bank_hash == bank->held_hash;
        return is_held ? TACTABLE_RESULT_OK : TACTABLE_RESULT_WRONG_STATE;
    }
    bank_end_transfer(bank);
    if (bank->taken != bank->transfer_size || message->bank_hash != bank->transfer_hash) {
        return TACTABLE_RESULT_WRONG_HASH;
    }
    const uint32_t crc = crc32_of(bank->bytes + bank->transfer_at, bank->taken, 0);
    if (message->bank_hash != (crc != 0 ? crc : HASH_INSTEAD_OF_0)) {
        return TACTABLE_RESULT_WRONG_HASH;
    }
    if (!is_valid(bank)) {
        return TACTABLE_RESULT_OUT_OF_RANGE;
    }
    bank->held_hash = message->bank_hash;
    bank->held_at = bank->transfer_at;
    bank->held_size = bank->transfer_size;
    return TACTABLE_RESULT_OK;
}

void bank_end_transfer(struct bank *bank)
{
    bank->is_transferring = false;
}

bool bank_waveform(const struct bank *bank, uint16_t index, struct waveform *waveform)
{
    const uint8_t *bytes = bank->bytes + bank->held_at;
    if (bank->held_hash == 0 || index >= number_of_waveforms(bytes)) {
        return false;
    }
    const uint32_t instant_size = SAMPLE_SIZE * bank->number_of_actuators;
    const uint8_t *samples = bytes + HEAD_SIZE + LENGTH_SIZE * number_of_waveforms(bytes);
    for (uint16_t i = 0; i < index; i++) {
        samples += (size_t)number_of_samples(bytes, i) * instant_size;
    }
    waveform->samples = samples;
    waveform->number_of_samples = number_of_samples(bytes, index);
    waveform->sample_rate_hz = sample_rate_hz(bytes);
    waveform->length_us = length_us(waveform->number_of_samples, waveform->sample_rate_hz);
    return true;
}
