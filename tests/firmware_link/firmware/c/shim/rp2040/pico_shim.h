/* What board.c uses of the Pico SDK and TinyUSB, declared and no more: for a syntax check where they are not installed.
 * The headers beside it have the SDK's names and lead here. */
#ifndef PICO_SHIM_H
#define PICO_SHIM_H

#include <stdbool.h>
#include <stdint.h>

typedef unsigned int uint;
typedef void (*irq_handler_t)(void);
enum gpio_function { GPIO_FUNC_PWM = 4 };
enum { GPIO_OUT = 1, PWM_IRQ_WRAP = 4 };

void gpio_init(uint gpio);
void gpio_set_dir(uint gpio, bool is_out);
void gpio_put(uint gpio, bool value);
void gpio_set_function(uint gpio, enum gpio_function function);
void irq_set_exclusive_handler(uint number, irq_handler_t handler);
void irq_set_enabled(uint number, bool is_enabled);
uint pwm_gpio_to_slice_num(uint gpio);
void pwm_set_wrap(uint slice, uint16_t wrap);
void pwm_set_both_levels(uint slice, uint16_t level_a, uint16_t level_b);
void pwm_set_enabled(uint slice, bool is_enabled);
void pwm_set_irq_enabled(uint slice, bool is_enabled);
void pwm_clear_irq(uint slice);
uint32_t save_and_disable_interrupts(void);
void restore_interrupts(uint32_t status);
uint32_t time_us_32(void);
void watchdog_enable(uint32_t delay_ms, bool pauses_on_debug);
void watchdog_update(void);
bool watchdog_caused_reboot(void);
uint32_t get_rand_32(void);

bool tusb_init(void);
void tud_task(void);
bool tud_suspended(void);
bool tud_cdc_connected(void);
uint32_t tud_cdc_available(void);
uint32_t tud_cdc_read(void *buffer, uint32_t size);
uint32_t tud_cdc_write(const void *buffer, uint32_t size);
uint32_t tud_cdc_write_available(void);
uint32_t tud_cdc_write_flush(void);

#endif
