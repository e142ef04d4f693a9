/* What the device says: answers at once, STATUS and FAULT when they are due, LOG not too often. */
#ifndef TACTABLE_REPORTS_H
#define TACTABLE_REPORTS_H

#include <stdbool.h>
#include <stdint.h>

#include "state.h"

void reports_send_hello(struct tactable_device *device, uint32_t nonce);
void reports_send_ack(struct tactable_device *device, uint8_t type, uint8_t sequence, enum tactable_result result);
void reports_send_time(struct tactable_device *device, uint64_t host_sent_ns);
void reports_send_log(
    struct tactable_device *device, enum tactable_log_level level, enum tactable_log_code code, uint32_t value);

/* Says what the accelerometer is. */
void reports_send_sensor(struct tactable_device *device);

/* Sends the first records of the accelerometer that wait. */
void reports_send_acceleration(struct tactable_device *device, uint32_t records);

/* Sends FAULT from now on until it is settled. */
void reports_raise_fault(struct tactable_device *device, enum tactable_fault_code fault);

/* Takes the ACK of a FAULT; false where it answers another message. */
bool reports_settle_fault(struct reports *reports, const struct tactable_ack *ack);

/* Sends what is due. */
void reports_advance(struct tactable_device *device);

#endif
