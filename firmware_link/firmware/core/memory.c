#include "memory.h"

#include "drive.h"
#include "reports.h"

static enum tactable_result begin_bank(struct tactable_device *device, const uint8_t *body)
{
    struct tactable_bank_begin message;
    tactable_read_bank_begin(body, &message);
    const bool is_idle = device->state == TACTABLE_DEVICE_STATE_IDLE;
    const enum tactable_result result = bank_begin(&device->bank, &message, is_idle);
    if (result == TACTABLE_RESULT_OK) {
        drive_release_transfer(device);
    }
    return result;
}

static enum tactable_result take_chunk(struct tactable_device *device, const uint8_t *body)
{
    struct tactable_bank_chunk message;
    tactable_read_bank_chunk(body, &message);
    return bank_take(&device->bank, &message);
}

static enum tactable_result commit_bank(struct tactable_device *device, const uint8_t *body)
{
    struct tactable_bank_commit message;
    tactable_read_bank_commit(body, &message);
    return bank_commit(&device->bank, &message);
}

/* Takes one step of the transfer of a bank. */
static enum tactable_result keep(struct tactable_device *device, const uint8_t *body)
{
    if (device->state == TACTABLE_DEVICE_STATE_LATCHED) {
        return TACTABLE_RESULT_WRONG_STATE;
    }
    switch (body[0]) {
    case TACTABLE_BANK_BEGIN_TYPE:
        return begin_bank(device, body);
    case TACTABLE_BANK_CHUNK_TYPE:
        return take_chunk(device, body);
    default:
        return commit_bank(device, body);
    }
}

enum outcome memory_keep(struct tactable_device *device, const uint8_t *body, uint8_t sequence)
{
    const uint32_t held_hash = device->bank.held_hash;
    const enum tactable_result result = keep(device, body);
    reports_send_ack(device, body[0], sequence, result);
    if (device->bank.held_hash != 0 && device->bank.held_hash != held_hash) {
        reports_send_log(
            device, TACTABLE_LOG_LEVEL_INFORMATION, TACTABLE_LOG_CODE_BANK_TAKEN, device->bank.held_hash);
    }
    return result == TACTABLE_RESULT_OK ? OUTCOME_ACCEPTED : OUTCOME_REFUSED;
}
