#include "session.h"

#include "device_time.h"
#include "drive.h"
#include "memory.h"
#include "reports.h"
#include "stream.h"

static uint16_t lesser(uint32_t one, uint32_t other)
{
    return (uint16_t)(one < other ? one : other);
}

/* The shorter of two limits in seconds; 0 means no limit. */
static uint64_t shorter_drive_us(uint8_t one_s, uint8_t other_s)
{
    if (one_s == 0 && other_s == 0) {
        return NEVER_US;
    }
    const uint8_t shorter_s = one_s == 0 || (other_s != 0 && other_s < one_s) ? other_s : one_s;
    return (uint64_t)shorter_s * US_PER_S;
}

static enum outcome greet(struct tactable_device *device, const uint8_t *body)
{
    struct tactable_hello_req message;
    if (!tactable_read_hello_req(body, &message) || message.magic != TACTABLE_MAGIC) {
        return OUTCOME_REFUSED;
    }
    session_silence(device, TACTABLE_DEVICE_STATE_IDLE);
    basis_end_transfer(&device->basis);
    stream_cut(device);
    reports_send_hello(device, message.nonce);
    if (!device->reports.was_greeted) {
        device->reports.was_greeted = true;
        reports_send_log(
            device, TACTABLE_LOG_LEVEL_INFORMATION, TACTABLE_LOG_CODE_BOOTED, device->configuration.reset_cause);
    }
    state_want_status(device, device->now_us);
    return OUTCOME_ACCEPTED;
}

static enum tactable_result arm(struct tactable_device *device, const uint8_t *body, uint8_t sequence)
{
    const struct tactable_configuration *configuration = &device->configuration;
    struct tactable_arm message;
    if (!tactable_read_arm(body, &message)) {
        return TACTABLE_RESULT_OUT_OF_RANGE;
    }
    if (message.boot_id != configuration->boot_id) {
        return TACTABLE_RESULT_WRONG_BOOT;
    }
    if (device->state != TACTABLE_DEVICE_STATE_IDLE && device->state != TACTABLE_DEVICE_STATE_ARMED) {
        return TACTABLE_RESULT_WRONG_STATE;
    }
    if (message.slew_limit_per_s == 0 || message.lease_ms == 0 || message.lease_ms > configuration->longest_lease_ms) {
        return TACTABLE_RESULT_OUT_OF_RANGE;
    }
    for (uint8_t i = 0; i < configuration->number_of_actuators; i++) {
        const uint16_t limit = tactable_read_arm_channel(body, i).amplitude_limit;
        device->channels.limits_to_come[i] = lesser(limit, configuration->amplitude_limit);
    }
    device->slew_to_come_per_s = lesser(message.slew_limit_per_s, configuration->slew_limit_per_s);
    device->lease.armed_us = (uint64_t)message.lease_ms * US_PER_MS;
    device->longest_drive_us = shorter_drive_us(message.longest_drive_s, configuration->longest_drive_s);
    lease_refresh(&device->lease, sequence, device->now_us);
    state_enter(device, TACTABLE_DEVICE_STATE_ARMED);
    return TACTABLE_RESULT_OK;
}

static enum outcome acknowledge(
    struct tactable_device *device, const uint8_t *body, uint8_t sequence, enum tactable_result result)
{
    reports_send_ack(device, body[0], sequence, result);
    return result == TACTABLE_RESULT_OK ? OUTCOME_ACCEPTED : OUTCOME_REFUSED;
}

static enum outcome answer_time(struct tactable_device *device, const uint8_t *body)
{
    struct tactable_time_req message;
    tactable_read_time_req(body, &message);
    reports_send_time(device, message.host_sent_ns);
    return OUTCOME_ACCEPTED;
}

static enum outcome settle_fault(struct tactable_device *device, const uint8_t *body)
{
    struct tactable_ack message;
    const bool is_settled = tactable_read_ack(body, &message) && reports_settle_fault(&device->reports, &message);
    return is_settled ? OUTCOME_ACCEPTED : OUTCOME_REFUSED;
}

static enum outcome dispatch(struct tactable_device *device, const uint8_t *body, uint8_t sequence)
{
    switch (body[0]) {
    case TACTABLE_SET_TYPE:
        return drive_set(device, body, sequence);
    case TACTABLE_PLAY_TYPE:
        return drive_play(device, body, sequence);
    case TACTABLE_KEEPALIVE_TYPE:
        return drive_keep_alive(device, body, sequence);
    case TACTABLE_HELLO_REQ_TYPE:
        return greet(device, body);
    case TACTABLE_ARM_TYPE:
        return acknowledge(device, body, sequence, arm(device, body, sequence));
    case TACTABLE_STOP_TYPE:
        session_silence(device, TACTABLE_DEVICE_STATE_LATCHED);
        return acknowledge(device, body, sequence, TACTABLE_RESULT_OK);
    case TACTABLE_TIME_REQ_TYPE:
        return answer_time(device, body);
    case TACTABLE_BASIS_BEGIN_TYPE:
    case TACTABLE_BASIS_CHUNK_TYPE:
    case TACTABLE_BASIS_COMMIT_TYPE:
        return memory_keep(device, body, sequence);
    case TACTABLE_SENSE_TYPE:
        return stream_ask(device, body);
    case TACTABLE_ACK_TYPE:
        return settle_fault(device, body);
    default:
        return OUTCOME_REFUSED;
    }
}

void session_silence(struct tactable_device *device, enum tactable_device_state state)
{
    drive_silence(device);
    state_enter(device, state);
}

void session_latch(struct tactable_device *device, enum tactable_fault_code fault)
{
    session_silence(device, TACTABLE_DEVICE_STATE_LATCHED);
    reports_raise_fault(device, fault);
}

void session_act_on(struct tactable_device *device, const uint8_t *body)
{
    const enum outcome outcome = dispatch(device, body, body[1]);
    device->counters.stale += outcome == OUTCOME_STALE;
    device->counters.refused += outcome == OUTCOME_REFUSED;
}
