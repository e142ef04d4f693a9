/* What the device says: answers at once, STATUS and FAULT when they are due, LOG not too often. */
#ifndef TACTABLE_REPORTS_H
#define TACTABLE_REPORTS_H

#include <stdbool.h>
#include <stdint.h>

#include "tactable_protocol.h"

struct tactable_device;

struct reports {
    uint64_t status_due_us;     /* NEVER_US until the first greeting */
    uint64_t status_allowed_us; /* not before: a new drive is reported soon, but not at the cost of the line */
    uint64_t fault_due_us;      /* NEVER_US unless one waits for its ACK */
    uint64_t fault_time_us;
    uint64_t log_allowed_us;
    uint8_t sequence;
    uint8_t fault_sequence;
    uint8_t applied_sequence;
    enum tactable_fault_code fault;
    bool was_greeted;
};

void reports_start(struct reports *reports);

void reports_send_hello(struct tactable_device *device, uint32_t nonce);
void reports_send_ack(struct tactable_device *device, uint8_t type, uint8_t sequence, enum tactable_result result);
void reports_send_time(struct tactable_device *device, uint64_t host_sent_ns);
void reports_send_log(
    struct tactable_device *device, enum tactable_log_level level, enum tactable_log_code code, uint32_t value);

/* STATUS is due no later than this. */
void reports_want_status(struct reports *reports, uint64_t due_us);

/* FAULT from now on until it is settled. */
void reports_raise_fault(struct tactable_device *device, enum tactable_fault_code fault);

/* The host acknowledged; false where it meant another message. */
bool reports_settle_fault(struct reports *reports, const struct tactable_ack *ack);

/* Sends what is due. */
void reports_advance(struct tactable_device *device);

#endif
