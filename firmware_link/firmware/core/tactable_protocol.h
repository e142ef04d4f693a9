/* The wire in C: made from firmware_link/protocol/messages.py by
 * `python -m tests.firmware_link.codegen.c_header`, not to be edited.
 *
 * A reader returns false for a value whose meaning is unknown, and leaves blocks of bytes where they are in the body;
 * a writer returns the end of what it wrote.
 */
#ifndef TACTABLE_PROTOCOL_H
#define TACTABLE_PROTOCOL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "bytes.h"

#define TACTABLE_VERSION_MAJOR 0x3u
#define TACTABLE_VERSION_MINOR 0x1u
#define TACTABLE_MAGIC 0x74636174u
#define TACTABLE_SCHEMA_HASH 0xf6b390ddu
#define TACTABLE_FULL_SCALE_WORD 0xffffu
#define TACTABLE_CLOCK_REFERENCE_US 0x64u
#define TACTABLE_CLOCK_REFERENCE_SPAN 0x10000u
#define TACTABLE_BASIS_CHUNK_SIZE 0xc0u
#define TACTABLE_MAXIMUM_WEIGHTS 0xffu
#define TACTABLE_MAXIMUM_FRACTION_BITS 0x1fu
#define TACTABLE_MAXIMUM_SENSED_VALUES 0x60u
#define TACTABLE_LONGEST_SENSE_MS 0x7d0u
#define TACTABLE_ACCELEROMETER 0x8u
#define TACTABLE_LINEARISES 0x10u
#define TACTABLE_EMERGENCY_STOP_RUN 0x8u

/* What the firmware allows: only DRIVING has a drive, only a handshake leaves LATCHED. */
enum tactable_device_state {
    TACTABLE_DEVICE_STATE_IDLE = 0,
    TACTABLE_DEVICE_STATE_ARMED = 1,
    TACTABLE_DEVICE_STATE_DRIVING = 2,
    TACTABLE_DEVICE_STATE_LATCHED = 3,
};

/* The answer that an ACK carries. */
enum tactable_result {
    TACTABLE_RESULT_OK = 0,
    TACTABLE_RESULT_WRONG_BOOT = 1,
    TACTABLE_RESULT_WRONG_STATE = 2,
    TACTABLE_RESULT_OUT_OF_RANGE = 3,
    TACTABLE_RESULT_NO_ROOM = 4,
    TACTABLE_RESULT_WRONG_HASH = 5,
};

/* Why the firmware disarmed itself. */
enum tactable_fault_code {
    TACTABLE_FAULT_CODE_NONE = 0,
    TACTABLE_FAULT_CODE_SILENT_HOST = 1,
    TACTABLE_FAULT_CODE_EMERGENCY_STOP = 2,
    TACTABLE_FAULT_CODE_HUNG_UP = 3,
    TACTABLE_FAULT_CODE_DRIVEN_TOO_LONG = 4,
};

/* What a device can do beyond SET; a newer device may tell bits that this host does not know. */
enum tactable_features {
    TACTABLE_FEATURES_WAVEFORMS = 1,
    TACTABLE_FEATURES_HIGH_VOLTAGE_SENSE = 4,
};

/* How much a LOG matters. */
enum tactable_log_level {
    TACTABLE_LOG_LEVEL_INFORMATION = 0,
    TACTABLE_LOG_LEVEL_WARNING = 1,
};

/* What a LOG says; LOG_TEXTS has the words, with {value} for its value. */
enum tactable_log_code {
    TACTABLE_LOG_CODE_BOOTED = 1,
    TACTABLE_LOG_CODE_LEASE_EXPIRED = 2,
    TACTABLE_LOG_CODE_PLAY_REFUSED = 3,
    TACTABLE_LOG_CODE_BASIS_TAKEN = 4,
};

/* Flags of a SET. */
enum tactable_set_flag {
    TACTABLE_SET_FLAG_WRITE_PHASE = 1,
};

/* How frames of one type are checked: the seed of their CRC and the length of their bodies. `length_each`
 * comes once for each actuator or, where `most` is not 0, as often as the byte before says, at most so. */
struct tactable_layout {
    uint32_t seed;
    uint16_t length;
    uint8_t length_each;
    uint8_t most;
    uint8_t type;
};

#define TACTABLE_LAYOUTS \
    {0x00000000u, 12u, 0u, 0u, 0x01u}, \
    {0x00000000u, 49u, 4u, 0u, 0x02u}, \
    {0xfab4ae66u, 10u, 2u, 0u, 0x03u}, \
    {0xc07f9951u, 5u, 0u, 0u, 0x04u}, \
    {0xa22d5939u, 6u, 6u, 0u, 0x05u}, \
    {0x8f7ef28eu, 5u, 0u, 0u, 0x06u}, \
    {0x00000000u, 2u, 0u, 0u, 0x07u}, \
    {0xa95bf990u, 10u, 0u, 0u, 0x08u}, \
    {0x2a2cab4du, 26u, 0u, 0u, 0x09u}, \
    {0x67aa7307u, 59u, 0u, 0u, 0x0au}, \
    {0x833c49edu, 11u, 0u, 0u, 0x0bu}, \
    {0xe1697ef3u, 17u, 0u, 0u, 0x0cu}, \
    {0x651fb466u, 10u, 0u, 0u, 0x0eu}, \
    {0x3cbffe4eu, 198u, 0u, 0u, 0x0fu}, \
    {0xe19d6d7cu, 6u, 0u, 0u, 0x10u}, \
    {0xcc8c73c2u, 9u, 2u, 255u, 0x11u}, \
    {0xd97bc7d1u, 4u, 0u, 0u, 0x12u}, \
    {0xbcc0ee5fu, 16u, 0u, 0u, 0x13u}, \
    {0xca2ec2d5u, 13u, 2u, 96u, 0x14u}

/* No body that a device sends is longer. */
#define TACTABLE_SENT_BODY_BOUND(number_of_actuators) \
    (59u + 4u * (number_of_actuators) > 205u ? 59u + 4u * (number_of_actuators) : 205u)

/* No body is longer. */
#define TACTABLE_BODY_BOUND(number_of_actuators) \
    (198u + 6u * (number_of_actuators) > 519u ? 198u + 6u * (number_of_actuators) : 519u)

/* HELLO_REQ, sent by host. Open a session; an armed device disarms, a latched one is released. */
#define TACTABLE_HELLO_REQ_TYPE 0x01u

struct tactable_hello_req {
    uint32_t magic;
    uint8_t version_major;
    uint8_t version_minor;
    uint32_t nonce;
};

static inline bool tactable_read_hello_req(const uint8_t *body, struct tactable_hello_req *message)
{
    message->magic = get_u32(body + 2);
    message->version_major = get_u8(body + 6);
    message->version_minor = get_u8(body + 7);
    message->nonce = get_u32(body + 8);
    return true;
}

/* HELLO, sent by device. What the device is and can do; the only message that says its own number of actuators. */
#define TACTABLE_HELLO_TYPE 0x02u

struct tactable_hello {
    uint8_t version_major;
    uint8_t version_minor;
    uint32_t nonce;
    uint32_t boot_id;
    uint32_t schema_hash;
    uint32_t features;
    uint8_t firmware_major;
    uint8_t firmware_minor;
    uint8_t firmware_patch;
    uint16_t board;
    uint32_t synthesis_rate_hz;
    uint32_t frequency_resolution_uhz;
    uint16_t frequency_minimum; /* frequency resolution */
    uint16_t frequency_maximum; /* frequency resolution */
    uint8_t longest_lease_ms;
    uint16_t longest_waveform_ms;
    uint32_t basis_capacity_bytes;
    uint32_t held_basis_hash;
    uint8_t number_of_actuators;
};

struct tactable_hello_channel {
    uint32_t full_scale_pm;
};

static inline uint8_t *tactable_write_hello(uint8_t *at, uint8_t sequence, const struct tactable_hello *message)
{
    at = put_u8(at, TACTABLE_HELLO_TYPE);
    at = put_u8(at, sequence);
    at = put_u8(at, message->version_major);
    at = put_u8(at, message->version_minor);
    at = put_u32(at, message->nonce);
    at = put_u32(at, message->boot_id);
    at = put_u32(at, message->schema_hash);
    at = put_u32(at, message->features);
    at = put_u8(at, message->firmware_major);
    at = put_u8(at, message->firmware_minor);
    at = put_u8(at, message->firmware_patch);
    at = put_u16(at, message->board);
    at = put_u32(at, message->synthesis_rate_hz);
    at = put_u32(at, message->frequency_resolution_uhz);
    at = put_u16(at, message->frequency_minimum);
    at = put_u16(at, message->frequency_maximum);
    at = put_u8(at, message->longest_lease_ms);
    at = put_u16(at, message->longest_waveform_ms);
    at = put_u32(at, message->basis_capacity_bytes);
    at = put_u32(at, message->held_basis_hash);
    at = put_u8(at, message->number_of_actuators);
    return at;
}

static inline uint8_t *tactable_write_hello_channel(uint8_t *at, const struct tactable_hello_channel *item)
{
    at = put_u32(at, item->full_scale_pm);
    return at;
}

/* ARM, sent by host. Allow drives within limits, for the named boot only. */
#define TACTABLE_ARM_TYPE 0x03u

struct tactable_arm {
    uint32_t boot_id;
    uint16_t slew_limit_per_s; /* full scale/s */
    uint8_t lease_ms;
    uint8_t longest_drive_s;
};

struct tactable_arm_channel {
    uint16_t amplitude_limit; /* full scale/65535 */
};

static inline bool tactable_read_arm(const uint8_t *body, struct tactable_arm *message)
{
    message->boot_id = get_u32(body + 2);
    message->slew_limit_per_s = get_u16(body + 6);
    message->lease_ms = get_u8(body + 8);
    message->longest_drive_s = get_u8(body + 9);
    return true;
}

static inline struct tactable_arm_channel tactable_read_arm_channel(const uint8_t *body, size_t index)
{
    const uint8_t *at = body + 10 + 2 * index;
    struct tactable_arm_channel item;
    item.amplitude_limit = get_u16(at + 0);
    return item;
}

/* ACK, sent by both. Answer to ARM, STOP, BASIS_* (device) or FAULT (host). */
#define TACTABLE_ACK_TYPE 0x04u

struct tactable_ack {
    uint8_t acknowledged_type;
    uint8_t acknowledged_sequence;
    uint8_t result;
};

static inline bool tactable_read_ack(const uint8_t *body, struct tactable_ack *message)
{
    message->acknowledged_type = get_u8(body + 2);
    message->acknowledged_sequence = get_u8(body + 3);
    message->result = get_u8(body + 4);
    return message->result <= 5u;
}

static inline uint8_t *tactable_write_ack(uint8_t *at, uint8_t sequence, const struct tactable_ack *message)
{
    at = put_u8(at, TACTABLE_ACK_TYPE);
    at = put_u8(at, sequence);
    at = put_u8(at, message->acknowledged_type);
    at = put_u8(at, message->acknowledged_sequence);
    at = put_u8(at, message->result);
    return at;
}

/* SET, sent by host. Drive for one lease; no answer, the latest wins. */
#define TACTABLE_SET_TYPE 0x05u

struct tactable_set {
    uint16_t clock_reference; /* 100 us */
    uint8_t flags;
    uint8_t lease_ms;
};

struct tactable_set_channel {
    uint16_t frequency; /* frequency resolution */
    uint16_t amplitude; /* full scale/65535 */
    uint16_t phase; /* turn/65536 */
};

static inline bool tactable_read_set(const uint8_t *body, struct tactable_set *message)
{
    message->clock_reference = get_u16(body + 2);
    message->flags = get_u8(body + 4);
    message->lease_ms = get_u8(body + 5);
    return (message->flags & ~0x1u) == 0;
}

static inline struct tactable_set_channel tactable_read_set_channel(const uint8_t *body, size_t index)
{
    const uint8_t *at = body + 6 + 6 * index;
    struct tactable_set_channel item;
    item.frequency = get_u16(at + 0);
    item.amplitude = get_u16(at + 2);
    item.phase = get_u16(at + 4);
    return item;
}

/* KEEPALIVE, sent by host. The host is alive; renew the lease of the named SET if it was applied last; no answer. */
#define TACTABLE_KEEPALIVE_TYPE 0x06u

struct tactable_keepalive {
    uint16_t clock_reference; /* 100 us */
    uint8_t applied_sequence;
};

static inline bool tactable_read_keepalive(const uint8_t *body, struct tactable_keepalive *message)
{
    message->clock_reference = get_u16(body + 2);
    message->applied_sequence = get_u8(body + 4);
    return true;
}

/* STOP, sent by host. Ramp to zero and latch. */
#define TACTABLE_STOP_TYPE 0x07u

/* TIME_REQ, sent by host. Ask for the device's clock. */
#define TACTABLE_TIME_REQ_TYPE 0x08u

struct tactable_time_req {
    uint64_t host_sent_ns;
};

static inline bool tactable_read_time_req(const uint8_t *body, struct tactable_time_req *message)
{
    message->host_sent_ns = get_u64(body + 2);
    return true;
}

/* TIME, sent by device. The request's own time, and the device's clock when the request came and when this left. */
#define TACTABLE_TIME_TYPE 0x09u

struct tactable_time {
    uint64_t host_sent_ns;
    uint64_t device_received_us;
    uint64_t device_sent_us;
};

static inline uint8_t *tactable_write_time(uint8_t *at, uint8_t sequence, const struct tactable_time *message)
{
    at = put_u8(at, TACTABLE_TIME_TYPE);
    at = put_u8(at, sequence);
    at = put_u64(at, message->host_sent_ns);
    at = put_u64(at, message->device_received_us);
    at = put_u64(at, message->device_sent_us);
    return at;
}

/* STATUS, sent by device. State, the command applied last, and counters since boot; periodic, and on change. */
#define TACTABLE_STATUS_TYPE 0x0au

struct tactable_status {
    uint8_t state;
    uint8_t fault;
    uint8_t applied_sequence;
    uint64_t device_time_us;
    uint64_t applied_time_us;
    uint16_t high_voltage_dv; /* 0.1 V */
    uint32_t applied;
    uint32_t ok;
    uint32_t crc;
    uint32_t framing;
    uint32_t length;
    uint32_t overrun;
    uint32_t stale;
    uint32_t refused;
    uint32_t trips;
};

static inline uint8_t *tactable_write_status(uint8_t *at, uint8_t sequence, const struct tactable_status *message)
{
    at = put_u8(at, TACTABLE_STATUS_TYPE);
    at = put_u8(at, sequence);
    at = put_u8(at, message->state);
    at = put_u8(at, message->fault);
    at = put_u8(at, message->applied_sequence);
    at = put_u64(at, message->device_time_us);
    at = put_u64(at, message->applied_time_us);
    at = put_u16(at, message->high_voltage_dv);
    at = put_u32(at, message->applied);
    at = put_u32(at, message->ok);
    at = put_u32(at, message->crc);
    at = put_u32(at, message->framing);
    at = put_u32(at, message->length);
    at = put_u32(at, message->overrun);
    at = put_u32(at, message->stale);
    at = put_u32(at, message->refused);
    at = put_u32(at, message->trips);
    return at;
}

/* FAULT, sent by device. The device disarmed itself; repeated until acknowledged. */
#define TACTABLE_FAULT_TYPE 0x0bu

struct tactable_fault {
    uint8_t fault;
    uint64_t device_time_us;
};

static inline uint8_t *tactable_write_fault(uint8_t *at, uint8_t sequence, const struct tactable_fault *message)
{
    at = put_u8(at, TACTABLE_FAULT_TYPE);
    at = put_u8(at, sequence);
    at = put_u8(at, message->fault);
    at = put_u64(at, message->device_time_us);
    return at;
}

/* LOG, sent by device. An event for people, as numbers; no answer. */
#define TACTABLE_LOG_TYPE 0x0cu

struct tactable_log {
    uint8_t level;
    uint16_t code;
    uint32_t value;
    uint64_t device_time_us;
};

static inline uint8_t *tactable_write_log(uint8_t *at, uint8_t sequence, const struct tactable_log *message)
{
    at = put_u8(at, TACTABLE_LOG_TYPE);
    at = put_u8(at, sequence);
    at = put_u8(at, message->level);
    at = put_u16(at, message->code);
    at = put_u32(at, message->value);
    at = put_u64(at, message->device_time_us);
    return at;
}

/* BASIS_BEGIN, sent by host. Begin to transfer a basis of clicks. */
#define TACTABLE_BASIS_BEGIN_TYPE 0x0eu

struct tactable_basis_begin {
    uint32_t basis_hash;
    uint32_t size_bytes;
};

static inline bool tactable_read_basis_begin(const uint8_t *body, struct tactable_basis_begin *message)
{
    message->basis_hash = get_u32(body + 2);
    message->size_bytes = get_u32(body + 6);
    return true;
}

/* BASIS_CHUNK, sent by host. The next bytes of the basis; the last chunk is filled up with zeros. */
#define TACTABLE_BASIS_CHUNK_TYPE 0x0fu

struct tactable_basis_chunk {
    uint32_t offset_bytes;
    const uint8_t *data;
};

static inline bool tactable_read_basis_chunk(const uint8_t *body, struct tactable_basis_chunk *message)
{
    message->offset_bytes = get_u32(body + 2);
    message->data = body + 6;
    return true;
}

/* BASIS_COMMIT, sent by host. Check the basis against its hash and hold it until the next one, or a reboot. */
#define TACTABLE_BASIS_COMMIT_TYPE 0x10u

struct tactable_basis_commit {
    uint32_t basis_hash;
};

static inline bool tactable_read_basis_commit(const uint8_t *body, struct tactable_basis_commit *message)
{
    message->basis_hash = get_u32(body + 2);
    return true;
}

/* PLAY, sent by host. Play a click, given as weights of a set of the basis, once; no answer, the latest SET or PLAY wins. */
#define TACTABLE_PLAY_TYPE 0x11u

struct tactable_play {
    uint16_t clock_reference; /* 100 us */
    uint8_t basis_set;
    uint8_t fraction_bits;
    uint16_t amplitude; /* full scale/65535 */
    uint8_t number_of_weights;
};

struct tactable_play_item {
    int16_t weight; /* 2^-fraction_bits */
};

static inline bool tactable_read_play(const uint8_t *body, struct tactable_play *message)
{
    message->clock_reference = get_u16(body + 2);
    message->basis_set = get_u8(body + 4);
    message->fraction_bits = get_u8(body + 5);
    message->amplitude = get_u16(body + 6);
    message->number_of_weights = get_u8(body + 8);
    return true;
}

static inline struct tactable_play_item tactable_read_play_item(const uint8_t *body, size_t index)
{
    const uint8_t *at = body + 9 + 2 * index;
    struct tactable_play_item item;
    item.weight = (int16_t)get_u16(at + 0);
    return item;
}

/* SENSE, sent by host. Send ACCELERATION for one lease, or with a lease of 0 no longer; answered by SENSOR. */
#define TACTABLE_SENSE_TYPE 0x12u

struct tactable_sense {
    uint16_t lease_ms;
};

static inline bool tactable_read_sense(const uint8_t *body, struct tactable_sense *message)
{
    message->lease_ms = get_u16(body + 2);
    return true;
}

/* SENSOR, sent by device. What the accelerometer is: nominal rate, scale of a count, greatest count, and samples that the device lost. */
#define TACTABLE_SENSOR_TYPE 0x13u

struct tactable_sensor {
    uint32_t rate_mhz; /* mHz */
    uint32_t scale_nm_per_s2; /* nm/s^2 */
    uint16_t greatest;
    uint32_t lost;
};

static inline uint8_t *tactable_write_sensor(uint8_t *at, uint8_t sequence, const struct tactable_sensor *message)
{
    at = put_u8(at, TACTABLE_SENSOR_TYPE);
    at = put_u8(at, sequence);
    at = put_u32(at, message->rate_mhz);
    at = put_u32(at, message->scale_nm_per_s2);
    at = put_u16(at, message->greatest);
    at = put_u32(at, message->lost);
    return at;
}

/* ACCELERATION, sent by device. Samples of the accelerometer, each followed by the displacement of every actuator at its instant. */
#define TACTABLE_ACCELERATION_TYPE 0x14u

struct tactable_acceleration {
    uint16_t frame;
    uint32_t number;
    uint32_t synthesis_sample;
    uint8_t number_of_values;
};

static inline uint8_t *tactable_write_acceleration(uint8_t *at, uint8_t sequence, const struct tactable_acceleration *message)
{
    at = put_u8(at, TACTABLE_ACCELERATION_TYPE);
    at = put_u8(at, sequence);
    at = put_u16(at, message->frame);
    at = put_u32(at, message->number);
    at = put_u32(at, message->synthesis_sample);
    at = put_u8(at, message->number_of_values);
    return at;
}

#endif
