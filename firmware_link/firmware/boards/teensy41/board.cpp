// Teensy 4.1 with its Arduino core: USB serial to the host, two PWM outputs, one pin to enable the high voltage.
//
// Pins 2 and 3 outputs (half duty is rest; a low-pass of 2 kHz follows), with ACTUATORS=4 also 4 and 6, with 8 up to 10;
// pin 5 high-voltage enable with an external pull-down, pin A0 high-voltage sense behind a divider by 1000.
#include <Arduino.h>
#include <IntervalTimer.h>

extern "C" {
#include "board.h"
#include "boot_id.h"
#include "main_loop.h"
}

namespace {

constexpr uint16_t board_number = 3;
#ifndef ACTUATORS
#define ACTUATORS 2
#endif
constexpr uint8_t actuators = ACTUATORS;
constexpr uint8_t output_pins[] = {2, 3, 4, 6, 7, 8, 9, 10};
constexpr uint8_t high_voltage_pin = 5;
constexpr uint8_t sense_pin = A0;
constexpr uint32_t basis_size = 131072;
constexpr uint32_t full_scale_pm = 520000;
constexpr uint32_t synthesis_rate_hz = 40000;
// 12 bits of a 150 MHz clock.
constexpr float pwm_frequency_hz = 36621.09f;
constexpr unsigned pwm_bits = 12;
// The full scale of the sense line: 3.3 V behind the divider, in 0.1 V, over 10 bits.
constexpr uint32_t sense_full_scale_dv = 33000;
constexpr uint32_t sense_steps = 1024;
constexpr uint32_t sense_period_us = 10000;
// WDOG1 counts half seconds, too slow; WDOG3 counts its 32 kHz clock: 50 ms.
constexpr uint32_t watchdog_ticks = 1638;

uint8_t basis_memory[basis_size];
IntervalTimer sample_timer;
bool was_connected;

uint32_t chance()
{
    CCM_CCGR6 |= CCM_CCGR6_TRNG(CCM_CCGR_ON);
    TRNG_MCTL = TRNG_MCTL_RST_DEF | TRNG_MCTL_PRGM;
    TRNG_MCTL = TRNG_MCTL_SAMP_MODE(2);
    const uint32_t started_ms = millis();
    while (!(TRNG_MCTL & (TRNG_MCTL_ENT_VAL | TRNG_MCTL_ERR)) && millis() - started_ms < 100) {
    }
    return TRNG_ENT0;
}

void start_watchdog()
{
    CCM_CCGR5 |= CCM_CCGR5_WDOG3(CCM_CCGR_ON);
    WDOG3_CNT = 0xd928c520;
    while (!(WDOG3_CS & WDOG_CS_ULK)) {
    }
    WDOG3_TOVAL = watchdog_ticks;
    WDOG3_CS = WDOG_CS_EN | WDOG_CS_UPDATE | WDOG_CS_CMD32EN | WDOG_CS_CLK(1);
}

} // namespace

extern "C" {

void board_describe(struct tactable_configuration *configuration)
{
    *configuration = tactable_configuration{};
    configuration->boot_id = next_boot_id(chance());
    configuration->reset_cause = SRC_SRSR;
    configuration->synthesis_rate_hz = synthesis_rate_hz;
    configuration->frequency_resolution_uhz = 10000;
    configuration->frequency_minimum = 100;
    configuration->frequency_maximum = 65535;
    configuration->amplitude_limit = 65535;
    configuration->slew_limit_per_s = 1000;
    configuration->board = board_number;
    configuration->number_of_actuators = actuators;
    configuration->longest_lease_ms = 100;
    configuration->senses_high_voltage = true;
    configuration->longest_waveform_ms = 2000;
    configuration->basis_capacity_bytes = basis_size;
    configuration->basis = basis_memory;
    for (uint8_t i = 0; i < actuators; i++) {
        configuration->full_scales_pm[i] = full_scale_pm;
    }
}

void board_start(void)
{
    const int16_t rest[actuators] = {0};
    pinMode(high_voltage_pin, OUTPUT);
    board_high_voltage(false);
    analogWriteResolution(pwm_bits);
    for (uint8_t i = 0; i < actuators; i++) {
        analogWriteFrequency(output_pins[i], pwm_frequency_hz);
    }
    board_write_outputs(rest);
    Serial.begin(0);
    start_watchdog();
    sample_timer.begin(main_loop_sample, 1e6f / synthesis_rate_hz);
}

uint32_t board_time_us(void)
{
    return micros();
}

size_t board_read(uint8_t *bytes, size_t room)
{
    size_t taken = 0;
    while (taken < room && Serial.available() > 0) {
        bytes[taken++] = static_cast<uint8_t>(Serial.read());
    }
    return taken;
}

void board_send(const uint8_t *frame, size_t length)
{
    if (static_cast<size_t>(Serial.availableForWrite()) >= length) {
        Serial.write(frame, length);
        Serial.send_now();
    }
}

// The core tells DTR; a suspended or unplugged bus clears its configuration.
enum board_line board_line(void)
{
    const bool is_connected = usb_configuration != 0 && Serial.dtr() != 0;
    const bool has_hung_up = was_connected && !is_connected;
    was_connected = is_connected;
    return has_hung_up ? BOARD_LINE_HUNG_UP : BOARD_LINE_UP;
}

void board_hold_samples(void)
{
    noInterrupts();
}

void board_release_samples(void)
{
    interrupts();
}

void board_write_outputs(const int16_t *displacements)
{
    for (uint8_t i = 0; i < actuators; i++) {
        analogWrite(output_pins[i], (displacements[i] + 32768) >> (16 - pwm_bits));
    }
}

bool board_sense(int16_t *acceleration)
{
    (void)acceleration;
    return false;
}

void board_high_voltage(bool is_on)
{
    digitalWriteFast(high_voltage_pin, is_on ? HIGH : LOW);
}

uint16_t board_high_voltage_dv(void)
{
    static uint32_t measured_us;
    static uint16_t high_voltage_dv;
    if (micros() - measured_us >= sense_period_us) {
        measured_us = micros();
        const uint32_t steps = static_cast<uint32_t>(analogRead(sense_pin));
        high_voltage_dv = static_cast<uint16_t>(steps * sense_full_scale_dv / sense_steps);
    }
    return high_voltage_dv;
}

void board_feed_watchdog(void)
{
    WDOG3_CNT = 0xb480a602;
}

void board_end_turn(void)
{
}

} // extern "C"

void setup()
{
    main_loop_start();
}

void loop()
{
    main_loop_turn();
}
