/* Classic ESP32 with ESP-IDF 5: Bluetooth serial (SPP) to the host, both 8-bit DACs, one pin to enable the high voltage.
 *
 * GPIO 25 and 26 outputs (mid-scale is rest), GPIO 27 high-voltage enable with an external pull-down. The driver writes
 * a DAC in about 10 us, which bounds the synthesis rate.
 */
#include "board.h"

#include "boot_id.h"
#include "driver/dac_oneshot.h"
#include "driver/gpio.h"
#include "driver/gptimer.h"
#include "esp_attr.h"
#include "esp_bt.h"
#include "esp_bt_device.h"
#include "esp_bt_main.h"
#include "esp_gap_bt_api.h"
#include "esp_random.h"
#include "esp_spp_api.h"
#include "esp_system.h"
#include "esp_task_wdt.h"
#include "esp_timer.h"
#include "freertos/FreeRTOS.h"
#include "freertos/task.h"
#include "main_loop.h"
#include "nvs_flash.h"
#include "ring.h"

#define BOARD 5u
#define ACTUATORS 2u
#define HIGH_VOLTAGE_ENABLE GPIO_NUM_27
#define BASIS_SIZE 32768u
#define FULL_SCALE_PM 520000u
#define SYNTHESIS_RATE_HZ 8000u
#define TIMER_HZ 1000000u
#define WATCHDOG_MS 50u
#define NAME "tactable"
#define CHUNK_SIZE 330u

#if configTICK_RATE_HZ < 1000
#error "set CONFIG_FREERTOS_HZ=1000: a turn of the main loop takes a tick"
#endif

static uint8_t basis[BASIS_SIZE];
static struct ring incoming, outgoing;
static dac_oneshot_handle_t outputs[ACTUATORS];
static portMUX_TYPE samples_lock = portMUX_INITIALIZER_UNLOCKED;
/* Of the connection, written by the Bluetooth task and read by the main loop. */
static volatile uint32_t connection;
static volatile bool has_hung_up, is_congested;

static void follow_connection(esp_spp_cb_event_t event, esp_spp_cb_param_t *parameters)
{
    switch (event) {
    case ESP_SPP_INIT_EVT:
        esp_spp_start_srv(ESP_SPP_SEC_AUTHENTICATE, ESP_SPP_ROLE_SLAVE, 0, NAME);
        break;
    case ESP_SPP_START_EVT:
        esp_bt_dev_set_device_name(NAME);
        esp_bt_gap_set_scan_mode(ESP_BT_CONNECTABLE, ESP_BT_GENERAL_DISCOVERABLE);
        break;
    case ESP_SPP_SRV_OPEN_EVT:
        connection = parameters->srv_open.handle;
        is_congested = false;
        break;
    case ESP_SPP_CLOSE_EVT:
        connection = 0;
        has_hung_up = true;
        break;
    case ESP_SPP_DATA_IND_EVT:
        for (uint16_t i = 0; i < parameters->data_ind.len; i++) {
            ring_put(&incoming, parameters->data_ind.data[i]);
        }
        break;
    case ESP_SPP_WRITE_EVT:
        is_congested = parameters->write.cong;
        break;
    case ESP_SPP_CONG_EVT:
        is_congested = parameters->cong.cong;
        break;
    default:
        break;
    }
}

static bool IRAM_ATTR sample(gptimer_handle_t timer, const gptimer_alarm_event_data_t *event, void *context)
{
    (void)timer;
    (void)event;
    (void)context;
    portENTER_CRITICAL_ISR(&samples_lock);
    main_loop_sample();
    portEXIT_CRITICAL_ISR(&samples_lock);
    return false;
}

static void start_bluetooth(void)
{
    esp_bt_controller_config_t controller = BT_CONTROLLER_INIT_CONFIG_DEFAULT();
    const esp_spp_cfg_t serial = {.mode = ESP_SPP_MODE_CB, .enable_l2cap_ertm = true, .tx_buffer_size = 0};
    ESP_ERROR_CHECK(nvs_flash_init());
    ESP_ERROR_CHECK(esp_bt_controller_mem_release(ESP_BT_MODE_BLE));
    ESP_ERROR_CHECK(esp_bt_controller_init(&controller));
    ESP_ERROR_CHECK(esp_bt_controller_enable(ESP_BT_MODE_CLASSIC_BT));
    ESP_ERROR_CHECK(esp_bluedroid_init());
    ESP_ERROR_CHECK(esp_bluedroid_enable());
    ESP_ERROR_CHECK(esp_spp_register_callback(follow_connection));
    ESP_ERROR_CHECK(esp_spp_enhanced_init(&serial));
}

static void start_samples(void)
{
    static const gptimer_config_t configuration = {
        .clk_src = GPTIMER_CLK_SRC_DEFAULT,
        .direction = GPTIMER_COUNT_UP,
        .resolution_hz = TIMER_HZ,
    };
    static const gptimer_alarm_config_t alarm = {
        .alarm_count = TIMER_HZ / SYNTHESIS_RATE_HZ,
        .flags = {.auto_reload_on_alarm = true},
    };
    static const gptimer_event_callbacks_t callbacks = {.on_alarm = sample};
    gptimer_handle_t timer;
    ESP_ERROR_CHECK(gptimer_new_timer(&configuration, &timer));
    ESP_ERROR_CHECK(gptimer_register_event_callbacks(timer, &callbacks, NULL));
    ESP_ERROR_CHECK(gptimer_set_alarm_action(timer, &alarm));
    ESP_ERROR_CHECK(gptimer_enable(timer));
    ESP_ERROR_CHECK(gptimer_start(timer));
}

static void start_watchdog(void)
{
    static const esp_task_wdt_config_t configuration = {.timeout_ms = WATCHDOG_MS, .trigger_panic = true};
    ESP_ERROR_CHECK(esp_task_wdt_reconfigure(&configuration));
    ESP_ERROR_CHECK(esp_task_wdt_add(NULL));
}

void board_describe(struct tactable_configuration *configuration)
{
    *configuration = (struct tactable_configuration){
        .boot_id = next_boot_id(esp_random()),
        .reset_cause = (uint32_t)esp_reset_reason(),
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
        .full_scales_pm = {FULL_SCALE_PM, FULL_SCALE_PM},
    };
}

void board_start(void)
{
    static const dac_oneshot_config_t channels[ACTUATORS] = {{.chan_id = DAC_CHAN_0}, {.chan_id = DAC_CHAN_1}};
    static const int16_t rest[ACTUATORS] = {0};
    ESP_ERROR_CHECK(gpio_set_direction(HIGH_VOLTAGE_ENABLE, GPIO_MODE_OUTPUT));
    board_high_voltage(false);
    for (unsigned i = 0; i < ACTUATORS; i++) {
        ESP_ERROR_CHECK(dac_oneshot_new_channel(&channels[i], &outputs[i]));
    }
    board_write_outputs(rest);
    start_bluetooth();
    start_samples();
    start_watchdog();
}

uint32_t board_time_us(void)
{
    return (uint32_t)esp_timer_get_time();
}

size_t board_read(uint8_t *bytes, size_t room)
{
    return ring_take_up_to(&incoming, bytes, room);
}

void board_send(const uint8_t *frame, size_t length)
{
    ring_put_all(&outgoing, frame, length);
}

enum board_line board_line(void)
{
    const bool is_hung_up = has_hung_up;
    has_hung_up = false;
    return is_hung_up ? BOARD_LINE_HUNG_UP : BOARD_LINE_UP;
}

void board_hold_samples(void)
{
    portENTER_CRITICAL(&samples_lock);
}

void board_release_samples(void)
{
    portEXIT_CRITICAL(&samples_lock);
}

void board_write_outputs(const int16_t *displacements)
{
    for (unsigned i = 0; i < ACTUATORS; i++) {
        dac_oneshot_output_voltage(outputs[i], (uint8_t)((displacements[i] + 32768) >> 8));
    }
}

bool board_sense(int16_t *acceleration)
{
    (void)acceleration;
    return false;
}

void board_high_voltage(bool is_on)
{
    gpio_set_level(HIGH_VOLTAGE_ENABLE, is_on);
}

uint16_t board_high_voltage_dv(void)
{
    return 0;
}

void board_feed_watchdog(void)
{
    esp_task_wdt_reset();
}

/* A tick of the operating system each turn lets its own tasks run: 1 ms with CONFIG_FREERTOS_HZ=1000, and
 * a tick may not be longer. */
void board_end_turn(void)
{
    uint8_t chunk[CHUNK_SIZE];
    if (connection != 0 && !is_congested) {
        const size_t length = ring_take_up_to(&outgoing, chunk, sizeof chunk);
        if (length != 0) {
            is_congested = true; /* until ESP_SPP_WRITE_EVT */
            esp_spp_write(connection, (int)length, chunk);
        }
    }
    vTaskDelay(1);
}

void app_main(void)
{
    main_loop_start();
    for (;;) {
        main_loop_turn();
    }
}
