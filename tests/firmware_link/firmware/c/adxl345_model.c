/* An ADXL345 by its registers, with the glue of a board, for tests of boards/adxl345.c. Facts by the data sheet. */
#include <string.h>

#include "../../../../firmware_link/firmware/boards/adxl345.h"

#define REGISTERS 0x40u
#define DATAX0 0x32u
#define DATA_END 0x38u

void adxl345_model_reset(bool is_there);
bool adxl345_model_start(void);
void adxl345_model_sample(int16_t x, int16_t y, int16_t z);
bool adxl345_model_turn(int16_t *acceleration);
uint8_t adxl345_model_register(uint8_t address);
uint32_t adxl345_model_faults(void);

static struct {
    uint8_t registers[REGISTERS];
    uint8_t address, answer;
    bool is_there, is_selected, has_address, is_reading, is_several, is_ready;
    uint32_t faults;
    struct adxl345 part;
} model;

static void select_part(bool is_selected)
{
    model.is_selected = is_selected;
    model.has_address = false;
}

static uint8_t exchange(uint8_t byte)
{
    if (!model.is_selected) {
        model.faults++;
        return 0;
    }
    if (!model.is_there) {
        return 0; /* pulled down */
    }
    if (!model.has_address) {
        model.has_address = true;
        model.is_reading = byte & 0x80u;
        model.is_several = byte & 0x40u;
        model.address = byte & 0x3fu;
        return 0;
    }
    const uint8_t address = model.address;
    model.address = (uint8_t)(address + (model.is_several ? 1u : 0u)) % REGISTERS;
    if (!model.is_reading) {
        model.registers[address] = byte;
        return 0;
    }
    /* Reading the data clears the interrupt. */
    model.is_ready = model.is_ready && !(address >= DATAX0 && address < DATA_END);
    return model.registers[address];
}

static bool int1(void)
{
    const bool is_enabled = (model.registers[0x2e] & 0x80u) != 0 && (model.registers[0x2f] & 0x80u) == 0;
    return model.is_ready && is_enabled;
}

void adxl345_model_reset(bool is_there)
{
    memset(&model, 0, sizeof model);
    model.is_there = is_there;
    model.registers[0x00] = 0xe5;
    model.registers[0x2c] = 0x0a;
}

bool adxl345_model_start(void)
{
    static const struct adxl345_bus bus = {select_part, exchange};
    return adxl345_start(&bus);
}

/* At 3200 and 1600 samples a second in full resolution the last bit is 0. */
void adxl345_model_sample(int16_t x, int16_t y, int16_t z)
{
    const int16_t values[3] = {x, y, z};
    if ((model.registers[0x2d] & 0x08u) == 0) {
        return;
    }
    for (uint8_t axis = 0; axis < 3u; axis++) {
        const int16_t end = values[axis] > 4095 ? 4095 : values[axis] < -4096 ? -4096 : values[axis];
        const uint16_t word = (uint16_t)end & (uint16_t)((model.registers[0x2c] & 0x0fu) >= 0x0eu ? 0xfffeu : 0xffffu);
        model.registers[DATAX0 + 2u * axis] = (uint8_t)word;
        model.registers[DATAX0 + 2u * axis + 1u] = (uint8_t)(word >> 8);
    }
    model.is_ready = true;
}

bool adxl345_model_turn(int16_t *acceleration)
{
    const struct adxl345_action action = adxl345_turn(&model.part, int1(), model.answer);
    if (action.step == ADXL345_BEGIN) {
        select_part(true);
    }
    if (action.step == ADXL345_BEGIN || action.step == ADXL345_SEND) {
        model.answer = exchange(action.byte);
    }
    if (action.step == ADXL345_END) {
        select_part(false);
        *acceleration = action.acceleration;
    }
    return action.step == ADXL345_END;
}

uint8_t adxl345_model_register(uint8_t address)
{
    return model.registers[address % REGISTERS];
}

uint32_t adxl345_model_faults(void)
{
    return model.faults;
}
