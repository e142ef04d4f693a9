#include "memory.h"

#include "drive.h"
#include "reports.h"

static enum tactable_result begin_basis(struct tactable_device *device, const uint8_t *body)
{
    struct tactable_basis_begin message;
    tactable_read_basis_begin(body, &message);
    const bool is_idle = device->state == TACTABLE_DEVICE_STATE_IDLE;
    const enum tactable_result result = basis_begin(&device->basis, &message, is_idle);
    if (result == TACTABLE_RESULT_OK) {
        drive_release_transfer(device);
    }
    return result;
}

static enum tactable_result take_chunk(struct tactable_device *device, const uint8_t *body)
{
    struct tactable_basis_chunk message;
    tactable_read_basis_chunk(body, &message);
    return basis_take(&device->basis, &message);
}

static enum tactable_result commit_basis(struct tactable_device *device, const uint8_t *body)
{
    struct tactable_basis_commit message;
    tactable_read_basis_commit(body, &message);
    return basis_commit(&device->basis, &message);
}

/* Takes one step of the transfer of a basis. */
static enum tactable_result keep(struct tactable_device *device, const uint8_t *body)
{
    if (device->state == TACTABLE_DEVICE_STATE_LATCHED) {
        return TACTABLE_RESULT_WRONG_STATE;
    }
    switch (body[0]) {
    case TACTABLE_BASIS_BEGIN_TYPE:
        return begin_basis(device, body);
    case TACTABLE_BASIS_CHUNK_TYPE:
        return take_chunk(device, body);
    default:
        return commit_basis(device, body);
    }
}

enum outcome memory_keep(struct tactable_device *device, const uint8_t *body, uint8_t sequence)
{
    const uint32_t held_hash = device->basis.held.hash;
    const enum tactable_result result = keep(device, body);
    reports_send_ack(device, body[0], sequence, result);
    if (device->basis.held.hash != 0 && device->basis.held.hash != held_hash) {
        reports_send_log(
            device, TACTABLE_LOG_LEVEL_INFORMATION, TACTABLE_LOG_CODE_BASIS_TAKEN, device->basis.held.hash);
    }
    return result == TACTABLE_RESULT_OK ? OUTCOME_ACCEPTED : OUTCOME_REFUSED;
}
