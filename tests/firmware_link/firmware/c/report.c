#include "report.h"

#include "board.h"
#include "cortex_m.h"
#include "main_loop.h"

#define PERIOD_US 1000u
#define LONGEST_WAIT 10000u

uint32_t report_time_us;

static uint16_t peaks[TACTABLE_ACTUATORS];
static bool is_high_voltage_on;

static void put_hexadecimal(void (*put)(uint8_t), uint32_t value, int digits, char end)
{
    for (int shift = 4 * (digits - 1); shift >= 0; shift -= 4) {
        put((uint8_t)"0123456789abcdef"[value >> shift & 15u]);
    }
    put((uint8_t)end);
}

static uint16_t take_peak(uint8_t actuator)
{
    board_hold_samples();
    const uint16_t peak = peaks[actuator];
    peaks[actuator] = 0;
    board_release_samples();
    return peak;
}

static void put_line(void (*put)(uint8_t))
{
    put_hexadecimal(put, the_device.configuration.boot_id, 8, ' ');
    put_hexadecimal(put, (uint32_t)the_device.now_us, 8, ' ');
    put_hexadecimal(put, (uint32_t)the_device.lease.renewed_us, 8, ' ');
    put_hexadecimal(put, (uint32_t)the_device.state, 1, ' ');
    put_hexadecimal(put, is_high_voltage_on, 1, ' ');
    for (uint8_t i = 0; i < the_device.configuration.number_of_actuators; i++) {
        put_hexadecimal(put, take_peak(i), 4, i + 1u < the_device.configuration.number_of_actuators ? ' ' : '\n');
    }
}

static void do_damage(uint8_t command)
{
    if (command == 's') {
        cortex_m_stop_system_timer();
    }
    while (command == 'w') {
    }
}

void report_outputs(const int16_t *displacements)
{
    for (uint8_t i = 0; i < the_device.configuration.number_of_actuators; i++) {
        const uint16_t size = (uint16_t)(displacements[i] < 0 ? -displacements[i] : displacements[i]);
        peaks[i] = size > peaks[i] ? size : peaks[i];
    }
}

void report_high_voltage(bool is_on)
{
    is_high_voltage_on = is_on;
}

void report_wait(void)
{
    const uint32_t samples = the_device.synthesis.samples;
    for (uint32_t i = 0; i < LONGEST_WAIT && the_device.synthesis.samples == samples; i++) {
    }
}

void report_done(void)
{
    __asm__ volatile("" ::: "memory");
}

void report_turn(uint8_t command, void (*put)(uint8_t character))
{
    const uint32_t now_us = (uint32_t)the_device.now_us;
    do_damage(command);
    if (now_us - report_time_us >= PERIOD_US) {
        report_time_us = now_us;
        put_line(put);
        report_done();
    }
}
