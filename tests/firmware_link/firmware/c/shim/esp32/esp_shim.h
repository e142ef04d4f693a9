/* What board.c uses of ESP-IDF 5, declared and no more: for a syntax check where it is not installed.
 * The headers beside it have ESP-IDF's names and lead here. */
#ifndef ESP_SHIM_H
#define ESP_SHIM_H

#include <stdbool.h>
#include <stdint.h>

#define configTICK_RATE_HZ 1000
typedef int esp_err_t;
#define ESP_ERROR_CHECK(call) ((void)(call))
#define IRAM_ATTR

typedef struct {
    int count;
} portMUX_TYPE;
#define portMUX_INITIALIZER_UNLOCKED {0}
void portENTER_CRITICAL(portMUX_TYPE *lock);
void portEXIT_CRITICAL(portMUX_TYPE *lock);
void portENTER_CRITICAL_ISR(portMUX_TYPE *lock);
void portEXIT_CRITICAL_ISR(portMUX_TYPE *lock);
void vTaskDelay(uint32_t ticks);

typedef enum { GPIO_NUM_27 = 27 } gpio_num_t;
typedef enum { GPIO_MODE_OUTPUT = 2 } gpio_mode_t;
esp_err_t gpio_set_direction(gpio_num_t number, gpio_mode_t mode);
esp_err_t gpio_set_level(gpio_num_t number, uint32_t level);

typedef enum { DAC_CHAN_0, DAC_CHAN_1 } dac_channel_t;
typedef struct dac_oneshot_s *dac_oneshot_handle_t;
typedef struct {
    dac_channel_t chan_id;
} dac_oneshot_config_t;
esp_err_t dac_oneshot_new_channel(const dac_oneshot_config_t *configuration, dac_oneshot_handle_t *handle);
esp_err_t dac_oneshot_output_voltage(dac_oneshot_handle_t handle, uint8_t value);

typedef struct gptimer_t *gptimer_handle_t;
enum { GPTIMER_CLK_SRC_DEFAULT = 4, GPTIMER_COUNT_UP = 1 };
typedef struct {
    int clk_src;
    int direction;
    uint32_t resolution_hz;
} gptimer_config_t;
typedef struct {
    uint64_t count_value;
    uint64_t alarm_value;
} gptimer_alarm_event_data_t;
typedef struct {
    uint64_t alarm_count;
    uint64_t reload_count;
    struct {
        uint32_t auto_reload_on_alarm : 1;
    } flags;
} gptimer_alarm_config_t;
typedef struct {
    bool (*on_alarm)(gptimer_handle_t timer, const gptimer_alarm_event_data_t *event, void *context);
} gptimer_event_callbacks_t;
esp_err_t gptimer_new_timer(const gptimer_config_t *configuration, gptimer_handle_t *timer);
esp_err_t gptimer_register_event_callbacks(
    gptimer_handle_t timer, const gptimer_event_callbacks_t *callbacks, void *context);
esp_err_t gptimer_set_alarm_action(gptimer_handle_t timer, const gptimer_alarm_config_t *alarm);
esp_err_t gptimer_enable(gptimer_handle_t timer);
esp_err_t gptimer_start(gptimer_handle_t timer);

uint32_t esp_random(void);
int64_t esp_timer_get_time(void);
typedef enum { ESP_RST_UNKNOWN } esp_reset_reason_t;
esp_reset_reason_t esp_reset_reason(void);
typedef struct {
    uint32_t timeout_ms;
    uint32_t idle_core_mask;
    bool trigger_panic;
} esp_task_wdt_config_t;
esp_err_t esp_task_wdt_reconfigure(const esp_task_wdt_config_t *configuration);
esp_err_t esp_task_wdt_add(void *task);
esp_err_t esp_task_wdt_reset(void);
esp_err_t nvs_flash_init(void);

typedef struct {
    int mode;
} esp_bt_controller_config_t;
#define BT_CONTROLLER_INIT_CONFIG_DEFAULT() {0}
typedef enum { ESP_BT_MODE_BLE = 1, ESP_BT_MODE_CLASSIC_BT = 2 } esp_bt_mode_t;
esp_err_t esp_bt_controller_mem_release(esp_bt_mode_t mode);
esp_err_t esp_bt_controller_init(esp_bt_controller_config_t *configuration);
esp_err_t esp_bt_controller_enable(esp_bt_mode_t mode);
esp_err_t esp_bluedroid_init(void);
esp_err_t esp_bluedroid_enable(void);
esp_err_t esp_bt_dev_set_device_name(const char *name);
enum { ESP_BT_CONNECTABLE = 1, ESP_BT_GENERAL_DISCOVERABLE = 2 };
esp_err_t esp_bt_gap_set_scan_mode(int connection_mode, int discovery_mode);

typedef enum {
    ESP_SPP_INIT_EVT,
    ESP_SPP_CLOSE_EVT = 27,
    ESP_SPP_START_EVT,
    ESP_SPP_DATA_IND_EVT = 30,
    ESP_SPP_CONG_EVT,
    ESP_SPP_WRITE_EVT = 33,
    ESP_SPP_SRV_OPEN_EVT,
} esp_spp_cb_event_t;
typedef union {
    struct {
        uint32_t handle;
    } srv_open;
    struct {
        uint16_t len;
        uint8_t *data;
    } data_ind;
    struct {
        bool cong;
    } write;
    struct {
        bool cong;
    } cong;
} esp_spp_cb_param_t;
typedef struct {
    int mode;
    bool enable_l2cap_ertm;
    uint16_t tx_buffer_size;
} esp_spp_cfg_t;
enum { ESP_SPP_MODE_CB, ESP_SPP_SEC_AUTHENTICATE = 0x12, ESP_SPP_ROLE_SLAVE = 1 };
esp_err_t esp_spp_register_callback(void (*callback)(esp_spp_cb_event_t event, esp_spp_cb_param_t *parameters));
esp_err_t esp_spp_enhanced_init(const esp_spp_cfg_t *configuration);
esp_err_t esp_spp_start_srv(int security, int role, uint8_t channel, const char *name);
esp_err_t esp_spp_write(uint32_t handle, int length, uint8_t *bytes);

#endif
