/* STM32F405: USART1 to the host, both 12-bit DACs to two amplifiers, one pin to enable the high voltage.
 *
 * PA9 TX, PA10 RX, PA4 and PA5 outputs (mid-scale is rest), PB0 high-voltage enable with an external pull-down. An
 * ADXL345 may lie on the bar, its Z axis across it: PB12 CS, PB13 SCL, PB14 SDO, PB15 SDA, PB1 INT1.
 * IN_QEMU is an image for `-M netduinoplus2`: its clocks need no start and its timers count faster, it has no DAC, no
 * watchdog and no source of chance; it reports on the second serial line.
 */
#include "board.h"

#include "adxl345.h"
#include "boot_id.h"
#include "cortex_m.h"
#include "main_loop.h"
#include "ring.h"
#ifdef IN_QEMU
#include "report.h"
#endif

#define CLOCK_HZ 168000000u
#define BOARD 2u
#define ACTUATORS 2u
#define BASIS_SIZE 65536u
#define FULL_SCALE_PM 520000u
#define LINE_CLOCK_HZ (CLOCK_HZ / 2u)
#define LINE_BIT_RATE_HZ 921600u
#ifdef IN_QEMU
#define SYNTHESIS_RATE_HZ 8000u
#define TIMER_CLOCK_HZ 1000000000u
#else
#define SYNTHESIS_RATE_HZ 48000u
#define TIMER_CLOCK_HZ (CLOCK_HZ / 2u)
#endif

#define RCC(offset) REGISTER(0x40023800u + (offset))
#define RCC_CR RCC(0x00u)
#define RCC_PLLCFGR RCC(0x04u)
#define RCC_CFGR RCC(0x08u)
#define RCC_AHB1ENR RCC(0x30u)
#define RCC_AHB2ENR RCC(0x34u)
#define RCC_APB1ENR RCC(0x40u)
#define RCC_APB2ENR RCC(0x44u)
#define RCC_CSR RCC(0x74u)
#define FLASH_ACR REGISTER(0x40023c00u)
#define GPIOA(offset) REGISTER(0x40020000u + (offset))
#define GPIOB(offset) REGISTER(0x40020400u + (offset))
#define GPIO_MODER 0x00u
#define GPIO_PUPDR 0x0cu
#define GPIO_IDR 0x10u
#define GPIO_BSRR 0x18u
#define GPIO_AFRH 0x24u
#define USART(offset) REGISTER(0x40011000u + (offset))
#define SECOND_USART(offset) REGISTER(0x40004400u + (offset))
#define USART_SR 0x00u
#define USART_DR 0x04u
#define USART_BRR 0x08u
#define USART_CR1 0x0cu
#define TIM2(offset) REGISTER(0x40000000u + (offset))
#define DAC(offset) REGISTER(0x40007400u + (offset))
#define IWDG(offset) REGISTER(0x40003000u + (offset))
#define SPI(offset) REGISTER(0x40003800u + (offset))
#define RNG(offset) REGISTER(0x50060800u + (offset))

#define USART_FRAMING_ERROR 0x02u
#define USART_RECEIVED 0x20u
#define USART_SENDABLE 0x80u
#define USART_ENABLE 0x200cu
#define USART_RECEIVE_INTERRUPT 0x20u
#define USART_INTERRUPT 37u
#define SPI_CR1 0x00u
#define SPI_SR 0x08u
#define SPI_DR 0x0cu
#define SPI_RECEIVED 0x01u
/* Master, software select, mode 3, enabled: 42 MHz by 16 are 2.6 MHz, of the 2 to 5 that the part takes at its rate. */
#define SPI_SETTING 0x035fu
#define SENSOR_CS 12u
#define SENSOR_READY 0x02u
/* Longer than any of these bits takes, and shorter than a person notices. */
#define PATIENCE 1000000u

static uint8_t basis[BASIS_SIZE];
static struct ring incoming, outgoing;
static volatile bool has_break;
static bool has_sensor;
static struct adxl345 sensor;

/* A BREAK is a framing error whose byte is 0. */
static void receive(void)
{
    const uint32_t status = USART(USART_SR);
    const uint8_t byte = (uint8_t)USART(USART_DR);
    if ((status & USART_FRAMING_ERROR) != 0 && byte == 0) {
        has_break = true;
    } else if (status & USART_RECEIVED) {
        ring_put(&incoming, byte);
    }
}

__attribute__((section(".board_interrupts"), used)) const cortex_m_handler board_interrupts[CORTEX_M_INTERRUPTS] = {
    [USART_INTERRUPT] = receive,
};

#ifdef IN_QEMU

static struct ring reports;

static void put_report(uint8_t character)
{
    ring_put(&reports, character);
}

static void start_clocks(void)
{
}

static void start_outputs(void)
{
    SECOND_USART(USART_CR1) = USART_ENABLE;
}

static void report(void)
{
    uint8_t byte;
    const bool has_command = SECOND_USART(USART_SR) & USART_RECEIVED;
    report_turn(has_command ? (uint8_t)SECOND_USART(USART_DR) : 0, put_report);
    while (ring_take(&reports, &byte)) {
        SECOND_USART(USART_DR) = byte;
    }
}

#else

/* Waits for bits. Without them the clock, and with it every lease, would be wrong: then the board stays off. */
static void need(volatile uint32_t *address, uint32_t mask, uint32_t value)
{
    for (uint32_t i = 0; i < PATIENCE; i++) {
        if ((*address & mask) == value) {
            return;
        }
    }
    for (;;) {
    }
}

/* 168 MHz from the crystal: 1 MHz to the PLL, times 336, by 2; by 7 to 48 MHz for the source of chance. */
static void start_clocks(void)
{
    RCC_CR |= 1u << 16;
    need(&RCC_CR, 1u << 17, 1u << 17);
    RCC_PLLCFGR = HSE_MHZ | 336u << 6 | 0u << 16 | 1u << 22 | 7u << 24;
    RCC_CR |= 1u << 24;
    need(&RCC_CR, 1u << 25, 1u << 25);
    FLASH_ACR = 0x705u; /* caches, prefetch, 5 wait states */
    need(&FLASH_ACR, 0xfu, 5u);
    RCC_CFGR = 5u << 10 | 4u << 13 | 2u; /* APB1 by 4, APB2 by 2, system clock from the PLL */
    need(&RCC_CFGR, 3u << 2, 2u << 2);
}

static void start_outputs(void)
{
    DAC(0x00u) = 1u << 16 | 1u;
    IWDG(0x00u) = 0x5555u;
    IWDG(0x04u) = 0;    /* 32 kHz by 4 */
    IWDG(0x08u) = 400u; /* 50 ms */
    IWDG(0x00u) = 0xccccu;
}

#endif

static void select_sensor(bool is_selected)
{
    GPIOB(GPIO_BSRR) = 1u << (is_selected ? SENSOR_CS + 16u : SENSOR_CS);
}

/* At the start only: a byte takes 3 us. */
static uint8_t exchange_with_sensor(uint8_t byte)
{
    SPI(SPI_DR) = byte;
    for (uint32_t i = 0; i < PATIENCE / 100u && (SPI(SPI_SR) & SPI_RECEIVED) == 0; i++) {
    }
    return (uint8_t)SPI(SPI_DR);
}

/* Pull-downs make a part that is not there read as zeros. */
static bool find_sensor(void)
{
    static const struct adxl345_bus bus = {select_sensor, exchange_with_sensor};
    RCC_AHB1ENR |= 2u;       /* GPIOB */
    RCC_APB1ENR |= 1u << 14; /* SPI2 */
    select_sensor(false);
    GPIOB(GPIO_PUPDR) |= 2u << 2 | 2u << 28;
    GPIOB(GPIO_AFRH) |= 5u << 20 | 5u << 24 | 5u << 28;
    GPIOB(GPIO_MODER) |= 1u << 24 | 2u << 26 | 2u << 28 | 2u << 30;
    SPI(SPI_CR1) = SPI_SETTING;
    return adxl345_start(&bus);
}

static uint32_t chance(void)
{
    RNG(0x00u) = 4u;
    for (uint32_t i = 0; i < PATIENCE / 100u; i++) {
        if (RNG(0x04u) & 1u) {
            return RNG(0x08u);
        }
    }
    return 0; /* the count of boots still differs */
}

void board_describe(struct tactable_configuration *configuration)
{
    start_clocks();
    RCC_AHB2ENR |= 1u << 6;
    has_sensor = find_sensor();
    *configuration = (struct tactable_configuration){
        .boot_id = next_boot_id(chance()),
        .reset_cause = RCC_CSR >> 24,
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
        .sensor_rate_mhz = has_sensor ? ADXL345_RATE_MHZ : 0,
        .sensor_scale_nm_per_s2 = ADXL345_SCALE_NM_PER_S2,
        .sensor_greatest = ADXL345_GREATEST,
        .sensor_delay_samples = ADXL345_TURNS,
    };
    RCC_CSR |= 1u << 24;
}

void board_start(void)
{
    static const int16_t rest[ACTUATORS] = {0};
    RCC_AHB1ENR |= 3u;             /* GPIOA, GPIOB */
    RCC_APB1ENR |= 1u << 29 | 1u;  /* DAC, TIM2 */
    RCC_APB2ENR |= 1u << 4;        /* USART1 */
    board_high_voltage(false);
    GPIOB(GPIO_MODER) |= 1u;                            /* PB0 output */
    GPIOA(GPIO_MODER) |= 0xfu << 8 | 2u << 18 | 2u << 20; /* PA4, PA5 analogue; PA9, PA10 alternate */
    GPIOA(GPIO_AFRH) |= 7u << 4 | 7u << 8;
    board_write_outputs(rest);
    start_outputs();
    USART(USART_BRR) = LINE_CLOCK_HZ / LINE_BIT_RATE_HZ;
    USART(USART_CR1) = USART_ENABLE | USART_RECEIVE_INTERRUPT;
    TIM2(0x28u) = TIMER_CLOCK_HZ / 1000000u - 1u;
    TIM2(0x2cu) = 0xffffffffu;
    TIM2(0x14u) = 1u; /* takes the prescaler over */
    TIM2(0x00u) = 1u;
    cortex_m_start_system_timer(CLOCK_HZ / SYNTHESIS_RATE_HZ);
    cortex_m_enable_interrupt(USART_INTERRUPT);
}

uint32_t board_time_us(void)
{
    return TIM2(0x24u);
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
    const bool is_broken = has_break;
    has_break = false;
    return is_broken ? BOARD_LINE_BREAK : BOARD_LINE_UP;
}

void board_hold_samples(void)
{
    cortex_m_hold_system_timer();
}

void board_release_samples(void)
{
    cortex_m_release_system_timer();
}

void board_write_outputs(const int16_t *displacements)
{
    const uint32_t first = (uint16_t)(displacements[0] + 32768), second = (uint16_t)(displacements[1] + 32768);
    DAC(0x24u) = (second & 0xfff0u) << 16 | (first & 0xfff0u); /* both at once, left-aligned */
#ifdef IN_QEMU
    report_outputs(displacements);
#endif
}

/* One byte a turn: it takes 3 us, and a turn 21. */
bool board_sense(int16_t *acceleration)
{
    if (!has_sensor) {
        return false;
    }
    const struct adxl345_action action =
        adxl345_turn(&sensor, (GPIOB(GPIO_IDR) & SENSOR_READY) != 0, (uint8_t)SPI(SPI_DR));
    switch (action.step) {
    case ADXL345_BEGIN:
        select_sensor(true);
        SPI(SPI_DR) = action.byte;
        break;
    case ADXL345_SEND:
        SPI(SPI_DR) = action.byte;
        break;
    case ADXL345_END:
        select_sensor(false);
        *acceleration = action.acceleration;
        return true;
    case ADXL345_WAIT:
        break;
    }
    return false;
}

void board_high_voltage(bool is_on)
{
    GPIOB(GPIO_BSRR) = is_on ? 1u : 1u << 16;
#ifdef IN_QEMU
    report_high_voltage(is_on);
#endif
}

uint16_t board_high_voltage_dv(void)
{
    return 0;
}

void board_feed_watchdog(void)
{
    IWDG(0x00u) = 0xaaaau;
}

void board_end_turn(void)
{
    uint8_t byte;
    while ((USART(USART_SR) & USART_SENDABLE) && ring_take(&outgoing, &byte)) {
        USART(USART_DR) = byte;
    }
#ifdef IN_QEMU
    report();
    report_wait();
#else
    cortex_m_wait_for_interrupt();
#endif
}
