/* RP2040 with the Pico SDK: USB serial to the host, two PWM outputs, one pin to enable the high voltage.
 *
 * GPIO 2 and 3 outputs (one PWM slice; half duty is rest; a low-pass of 2 kHz follows), with ACTUATORS=4 also 6 and 7,
 * with 8 up to 11; GPIO 5 high-voltage enable with an external pull-down. The PWM of the first two outputs is the sample
 * clock too: 125 MHz / 4000 = 31250 Hz.
 */
#include "board.h"

#include "boot_id.h"
#include "hardware/gpio.h"
#include "hardware/irq.h"
#include "hardware/pwm.h"
#include "hardware/sync.h"
#include "hardware/timer.h"
#include "hardware/watchdog.h"
#include "main_loop.h"
#include "pico/rand.h"
#include "tusb.h"

#define BOARD 4u
/* An even number up to 8: a slice of the PWM has two outputs. */
#ifndef ACTUATORS
#define ACTUATORS 2u
#endif
#define FIRST_OUTPUT 2u
#define HIGH_VOLTAGE_ENABLE 5u
#define BASIS_SIZE 131072u
#define FULL_SCALE_PM 520000u
#define PWM_STEPS 4000u
#define SYNTHESIS_RATE_HZ 31250u
#define WATCHDOG_MS 50u

static uint8_t basis[BASIS_SIZE];
static const uint8_t outputs[] = {FIRST_OUTPUT, FIRST_OUTPUT + 1u, 6, 7, 8, 9, 10, 11};
static bool was_connected;
static uint32_t held_interrupts;

static void sample(void)
{
    pwm_clear_irq(pwm_gpio_to_slice_num(FIRST_OUTPUT));
    main_loop_sample();
}

static uint16_t level(int16_t displacement)
{
    return (uint16_t)((uint32_t)(displacement + 32768) * PWM_STEPS >> 16);
}

void board_describe(struct tactable_configuration *configuration)
{
    *configuration = (struct tactable_configuration){
        .boot_id = next_boot_id(get_rand_32()),
        .reset_cause = watchdog_caused_reboot(),
        .synthesis_rate_hz = SYNTHESIS_RATE_HZ,
        .frequency_resolution_uhz = 10000,
        .frequency_minimum = 100,
        .frequency_maximum = 65535,
        .amplitude_limit = 65535,
        .slew_limit_per_s = 1000,
        .board = BOARD,
        .number_of_actuators = ACTUATORS,
        .longest_lease_ms = 100,
        .longest_waveform_ms = 1000,
        .basis_capacity_bytes = BASIS_SIZE,
        .basis = basis,
    };
    for (unsigned i = 0; i < ACTUATORS; i++) {
        configuration->full_scales_pm[i] = FULL_SCALE_PM;
    }
}

void board_start(void)
{
    static const int16_t rest[ACTUATORS] = {0};
    const uint slice = pwm_gpio_to_slice_num(FIRST_OUTPUT);
    gpio_init(HIGH_VOLTAGE_ENABLE);
    gpio_set_dir(HIGH_VOLTAGE_ENABLE, GPIO_OUT);
    board_high_voltage(false);
    for (unsigned i = 0; i < ACTUATORS; i += 2) {
        pwm_set_wrap(pwm_gpio_to_slice_num(outputs[i]), PWM_STEPS - 1u);
    }
    board_write_outputs(rest);
    for (unsigned i = 0; i < ACTUATORS; i++) {
        gpio_set_function(outputs[i], GPIO_FUNC_PWM);
    }
    tusb_init();
    watchdog_enable(WATCHDOG_MS, true);
    pwm_clear_irq(slice);
    pwm_set_irq_enabled(slice, true);
    irq_set_exclusive_handler(PWM_IRQ_WRAP, sample);
    irq_set_enabled(PWM_IRQ_WRAP, true);
    for (unsigned i = 0; i < ACTUATORS; i += 2) {
        pwm_set_enabled(pwm_gpio_to_slice_num(outputs[i]), true);
    }
}

uint32_t board_time_us(void)
{
    return time_us_32();
}

size_t board_read(uint8_t *bytes, size_t room)
{
    return tud_cdc_available() != 0 ? tud_cdc_read(bytes, (uint32_t)room) : 0;
}

void board_send(const uint8_t *frame, size_t length)
{
    if (tud_cdc_write_available() >= length) {
        tud_cdc_write(frame, (uint32_t)length);
        tud_cdc_write_flush();
    }
}

enum board_line board_line(void)
{
    const bool is_connected = tud_cdc_connected() && !tud_suspended();
    const bool has_hung_up = was_connected && !is_connected;
    was_connected = is_connected;
    return has_hung_up ? BOARD_LINE_HUNG_UP : BOARD_LINE_UP;
}

void board_hold_samples(void)
{
    held_interrupts = save_and_disable_interrupts();
}

void board_release_samples(void)
{
    restore_interrupts(held_interrupts);
}

void board_write_outputs(const int16_t *displacements)
{
    for (unsigned i = 0; i < ACTUATORS; i += 2) {
        pwm_set_both_levels(pwm_gpio_to_slice_num(outputs[i]), level(displacements[i]), level(displacements[i + 1u]));
    }
}

bool board_sense(int16_t *acceleration)
{
    (void)acceleration;
    return false;
}

void board_high_voltage(bool is_on)
{
    gpio_put(HIGH_VOLTAGE_ENABLE, is_on);
}

uint16_t board_high_voltage_dv(void)
{
    return 0;
}

void board_feed_watchdog(void)
{
    watchdog_update();
}

void board_end_turn(void)
{
    tud_task();
}

int main(void)
{
    main_loop_start();
    for (;;) {
        main_loop_turn();
    }
}
