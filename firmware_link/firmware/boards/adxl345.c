#include "adxl345.h"

#include <stddef.h>

#define READ 0x80u
#define SEVERAL 0x40u
#define DEVID 0x00u
#define BW_RATE 0x2cu
#define POWER_CTL 0x2du
#define INT_ENABLE 0x2eu
#define INT_MAP 0x2fu
#define DATA_FORMAT 0x31u
#define DATAX0 0x32u
#define ADXL345_ID 0xe5u
/* Low byte of Z in what a reading brings: behind the address come X, Y and Z. */
#define Z_LOW 5u

static const struct {
    uint8_t address, value;
} settings[] = {
    {POWER_CTL, 0x00},   /* standby while it is set up */
    {BW_RATE, 0x0f},     /* 3200 Hz */
    {DATA_FORMAT, 0x0b}, /* full resolution, 16 g */
    {INT_MAP, 0x00},     /* to INT1 */
    {INT_ENABLE, 0x80},  /* data ready */
    {POWER_CTL, 0x08},   /* measure */
};

static uint8_t transfer(const struct adxl345_bus *bus, uint8_t address, uint8_t value)
{
    bus->select(true);
    bus->exchange(address);
    const uint8_t answer = bus->exchange(value);
    bus->select(false);
    return answer;
}

bool adxl345_start(const struct adxl345_bus *bus)
{
    if (transfer(bus, DEVID | READ, 0) != ADXL345_ID) {
        return false;
    }
    for (size_t i = 0; i < sizeof settings / sizeof *settings; i++) {
        transfer(bus, settings[i].address, settings[i].value);
    }
    return true;
}

struct adxl345_action adxl345_turn(struct adxl345 *part, bool is_ready, uint8_t received)
{
    if (part->turn == 0) {
        if (!is_ready) {
            return (struct adxl345_action){ADXL345_WAIT, 0, 0};
        }
        part->turn = 1;
        return (struct adxl345_action){ADXL345_BEGIN, DATAX0 | READ | SEVERAL, 0};
    }
    part->bytes[part->turn - 1u] = received;
    if (part->turn < ADXL345_TURNS) {
        part->turn++;
        return (struct adxl345_action){ADXL345_SEND, 0, 0};
    }
    part->turn = 0;
    const uint16_t z = (uint16_t)(part->bytes[Z_LOW] | (uint16_t)(part->bytes[Z_LOW + 1u] << 8));
    return (struct adxl345_action){ADXL345_END, 0, (int16_t)z};
}
