#include "basis.h"

#include <string.h>

#include "crc32.h"
#include "device_time.h"

#define HEAD_SIZE 4u
#define SET_HEAD_SIZE 4u
#define SAMPLE_SIZE 2u
#define SHORTEST_WAVEFORM 2u
#define MAXIMUM_SETS 256u
/* A hash of 0 means that no basis is held. */
#define HASH_INSTEAD_OF_0 1u

static uint16_t sample_rate_hz(const uint8_t *bytes)
{
    return get_u16(bytes);
}

static uint16_t number_of_sets(const uint8_t *bytes)
{
    return get_u16(bytes + 2);
}

static uint16_t number_of_samples(const uint8_t *bytes, uint16_t index)
{
    return get_u16(bytes + HEAD_SIZE + SET_HEAD_SIZE * index);
}

static uint16_t number_of_functions(const uint8_t *bytes, uint16_t index)
{
    return get_u16(bytes + HEAD_SIZE + SET_HEAD_SIZE * index + 2);
}

/* Up to 18 hours, which 32 bits do not hold. */
static uint64_t length_us(uint16_t samples, uint16_t rate_hz)
{
    return ((uint64_t)(samples - 1u) * US_PER_S + rate_hz - 1u) / rate_hz;
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

/* Whether the functions of a set, whose bytes begin at `set`, move actuators that are there and are 0 at both ends. */
static bool is_valid_set(const struct basis *basis, const uint8_t *set, uint16_t samples, uint16_t functions)
{
    for (uint16_t i = 0; i < functions; i++) {
        if (set[i] >= basis->number_of_actuators) {
            return false;
        }
    }
    const size_t instant_size = (size_t)SAMPLE_SIZE * functions;
    const uint8_t *first = set + functions, *last = first + (samples - 1u) * instant_size;
    return is_zero(first, instant_size) && is_zero(last, instant_size);
}

/* Whether all sets are within bounds and valid, and fill the bytes exactly. */
static bool is_valid(const struct basis *basis, const uint8_t *bytes, uint32_t size)
{
    if (size < HEAD_SIZE || sample_rate_hz(bytes) == 0 || number_of_sets(bytes) == 0
        || number_of_sets(bytes) > MAXIMUM_SETS) {
        return false;
    }
    uint32_t at = HEAD_SIZE + SET_HEAD_SIZE * number_of_sets(bytes);
    if (size < at) {
        return false;
    }
    for (uint16_t i = 0; i < number_of_sets(bytes); i++) {
        const uint16_t samples = number_of_samples(bytes, i), functions = number_of_functions(bytes, i);
        if (samples < SHORTEST_WAVEFORM || functions == 0 || functions > TACTABLE_MAXIMUM_WEIGHTS) {
            return false;
        }
        const uint32_t set_size = functions * (1u + SAMPLE_SIZE * samples);
        if (size - at < set_size || !is_valid_set(basis, bytes + at, samples, functions)) {
            return false;
        }
        if (length_us(samples, sample_rate_hz(bytes)) > basis->longest_waveform_us) {
            return false;
        }
        at += set_size;
    }
    return at == size;
}

enum tactable_result basis_begin(struct basis *basis, const struct tactable_basis_begin *message, bool may_forget)
{
    const uint32_t hash = message->basis_hash, size = message->size_bytes;
    const struct basis_place *held = &basis->held, *transfer = &basis->transfer;
    if (hash == 0) {
        return TACTABLE_RESULT_OUT_OF_RANGE;
    }
    if (hash == transfer->hash && size == transfer->size) {
        return TACTABLE_RESULT_OK;
    }
    if (size > basis->capacity_bytes) {
        return TACTABLE_RESULT_NO_ROOM;
    }
    /* Before the basis that is held, or else behind it. */
    uint32_t at = held->hash == 0 || size <= held->at ? 0 : held->at + held->size;
    if (size > basis->capacity_bytes - at) {
        if (!may_forget) {
            return TACTABLE_RESULT_NO_ROOM;
        }
        basis->held.hash = at = 0;
    }
    basis->transfer = (struct basis_place){hash, at, size};
    basis->taken = 0;
    return TACTABLE_RESULT_OK;
}

enum tactable_result basis_take(struct basis *basis, const struct tactable_basis_chunk *message)
{
    const struct basis_place *transfer = &basis->transfer;
    const uint32_t offset = message->offset_bytes;
    if (transfer->hash == 0) {
        return TACTABLE_RESULT_WRONG_STATE;
    }
    if (offset < basis->taken && offset % TACTABLE_BASIS_CHUNK_SIZE == 0) {
        return TACTABLE_RESULT_OK;
    }
    if (offset != basis->taken || offset >= transfer->size) {
        return TACTABLE_RESULT_OUT_OF_RANGE;
    }
    const uint32_t rest = transfer->size - offset;
    const uint32_t size = rest < TACTABLE_BASIS_CHUNK_SIZE ? rest : TACTABLE_BASIS_CHUNK_SIZE;
    memcpy(basis->bytes + transfer->at + offset, message->data, size);
    basis->taken += size;
    return TACTABLE_RESULT_OK;
}

enum tactable_result basis_commit(struct basis *basis, const struct tactable_basis_commit *message)
{
    const struct basis_place transfer = basis->transfer;
    if (transfer.hash == 0) {
        const bool is_held = basis->held.hash != 0 && message->basis_hash == basis->held.hash;
        return is_held ? TACTABLE_RESULT_OK : TACTABLE_RESULT_WRONG_STATE;
    }
    basis_end_transfer(basis);
    if (basis->taken != transfer.size || message->basis_hash != transfer.hash) {
        return TACTABLE_RESULT_WRONG_HASH;
    }
    const uint8_t *bytes = basis->bytes + transfer.at;
    const uint32_t crc = crc32_of(bytes, transfer.size, 0);
    if (transfer.hash != (crc != 0 ? crc : HASH_INSTEAD_OF_0)) {
        return TACTABLE_RESULT_WRONG_HASH;
    }
    if (!is_valid(basis, bytes, transfer.size)) {
        return TACTABLE_RESULT_OUT_OF_RANGE;
    }
    basis->held = transfer;
    return TACTABLE_RESULT_OK;
}

void basis_end_transfer(struct basis *basis)
{
    basis->transfer.hash = 0;
}

bool basis_find_set(const struct basis *basis, uint8_t index, struct basis_set *set)
{
    const uint8_t *bytes = basis->bytes + basis->held.at;
    if (basis->held.hash == 0 || index >= number_of_sets(bytes)) {
        return false;
    }
    const uint8_t *at = bytes + HEAD_SIZE + SET_HEAD_SIZE * number_of_sets(bytes);
    for (uint16_t i = 0; i < index; i++) {
        at += (size_t)number_of_functions(bytes, i) * (1u + SAMPLE_SIZE * number_of_samples(bytes, i));
    }
    *set = (struct basis_set){
        .actuators = at,
        .samples = at + number_of_functions(bytes, index),
        .length_us = (uint32_t)length_us(number_of_samples(bytes, index), sample_rate_hz(bytes)),
        .number_of_samples = number_of_samples(bytes, index),
        .sample_rate_hz = sample_rate_hz(bytes),
        .number_of_functions = (uint8_t)number_of_functions(bytes, index),
    };
    return true;
}
