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
static bool is_valid(const struct basis *basis)
{
    const uint8_t *bytes = basis->bytes + basis->transfer_at;
    const uint32_t size = basis->taken;
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

/* Finds the place of a basis of this size beside the one that is held; false where there is no room. */
static bool find_room(struct basis *basis, uint32_t size)
{
    if (basis->held_hash == 0 || size <= basis->held_at) {
        basis->transfer_at = 0;
        return true;
    }
    basis->transfer_at = basis->held_at + basis->held_size;
    return size <= basis->capacity_bytes - basis->transfer_at;
}

enum tactable_result basis_begin(struct basis *basis, const struct tactable_basis_begin *message, bool may_forget)
{
    if (basis->is_transferring && message->basis_hash == basis->transfer_hash && message->size_bytes == basis->transfer_size) {
        return TACTABLE_RESULT_OK;
    }
    if (message->basis_hash == 0) {
        return TACTABLE_RESULT_OUT_OF_RANGE;
    }
    if (message->size_bytes > basis->capacity_bytes) {
        return TACTABLE_RESULT_NO_ROOM;
    }
    if (!find_room(basis, message->size_bytes)) {
        if (!may_forget) {
            return TACTABLE_RESULT_NO_ROOM;
        }
        basis->held_hash = 0;
        basis->transfer_at = 0;
    }
    basis->is_transferring = true;
    basis->transfer_hash = message->basis_hash;
    basis->transfer_size = message->size_bytes;
    basis->taken = 0;
    return TACTABLE_RESULT_OK;
}

enum tactable_result basis_take(struct basis *basis, const struct tactable_basis_chunk *message)
{
    if (!basis->is_transferring) {
        return TACTABLE_RESULT_WRONG_STATE;
    }
    const uint32_t offset = message->offset_bytes;
    if (offset < basis->taken && offset % TACTABLE_BASIS_CHUNK_SIZE == 0) {
        return TACTABLE_RESULT_OK;
    }
    if (offset != basis->taken || offset >= basis->transfer_size) {
        return TACTABLE_RESULT_OUT_OF_RANGE;
    }
    const uint32_t rest = basis->transfer_size - offset;
    const uint32_t size = rest < TACTABLE_BASIS_CHUNK_SIZE ? rest : TACTABLE_BASIS_CHUNK_SIZE;
    memcpy(basis->bytes + basis->transfer_at + offset, message->data, size);
    basis->taken += size;
    return TACTABLE_RESULT_OK;
}

enum tactable_result basis_commit(struct basis *basis, const struct tactable_basis_commit *message)
{
    if (!basis->is_transferring) {
        const bool is_held = basis->held_hash != 0 && message->basis_hash == basis->held_hash;
        return is_held ? TACTABLE_RESULT_OK : TACTABLE_RESULT_WRONG_STATE;
    }
    basis_end_transfer(basis);
    if (basis->taken != basis->transfer_size || message->basis_hash != basis->transfer_hash) {
        return TACTABLE_RESULT_WRONG_HASH;
    }
    const uint32_t crc = crc32_of(basis->bytes + basis->transfer_at, basis->taken, 0);
    if (message->basis_hash != (crc != 0 ? crc : HASH_INSTEAD_OF_0)) {
        return TACTABLE_RESULT_WRONG_HASH;
    }
    if (!is_valid(basis)) {
        return TACTABLE_RESULT_OUT_OF_RANGE;
    }
    basis->held_hash = message->basis_hash;
    basis->held_at = basis->transfer_at;
    basis->held_size = basis->transfer_size;
    return TACTABLE_RESULT_OK;
}

void basis_end_transfer(struct basis *basis)
{
    basis->is_transferring = false;
}

bool basis_find_set(const struct basis *basis, uint8_t index, struct basis_set *set)
{
    const uint8_t *bytes = basis->bytes + basis->held_at;
    if (basis->held_hash == 0 || index >= number_of_sets(bytes)) {
        return false;
    }
    const uint8_t *at = bytes + HEAD_SIZE + SET_HEAD_SIZE * number_of_sets(bytes);
    for (uint16_t i = 0; i < index; i++) {
        at += (size_t)number_of_functions(bytes, i) * (1u + SAMPLE_SIZE * number_of_samples(bytes, i));
    }
    *set = (struct basis_set){
        .actuators = at,
        .samples = at + number_of_functions(bytes, index),
        .length_us = length_us(number_of_samples(bytes, index), sample_rate_hz(bytes)),
        .number_of_samples = number_of_samples(bytes, index),
        .sample_rate_hz = sample_rate_hz(bytes),
        .number_of_functions = (uint8_t)number_of_functions(bytes, index),
    };
    return true;
}
