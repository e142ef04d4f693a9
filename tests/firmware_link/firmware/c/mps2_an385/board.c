/* Arm MPS2 with the AN385 image, as QEMU emulates it: serial line, no actuators. Reports on the second serial line. */
#include "board.h"

#include "boot_id.h"
#include "cortex_m.h"
#include "main_loop.h"
#include "report.h"
#include "ring.h"

#define CLOCK_HZ 25000000u
/* High enough for the frequencies of the actuators, and light to emulate. */
#define SYNTHESIS_RATE_HZ 8000u
#define BOARD 1u
#ifndef ACTUATORS
#define ACTUATORS 2u
#endif
#define BASIS_SIZE 262144u
#define FULL_SCALE_PM 520000u
/* Samples of the synthesis for one of the accelerometer. */
#define SENSE_TURNS 8u
#define SENSE_SCALE_NM_PER_S2 38303000u
#define SENSE_GREATEST 32767u
#define LONGEST_REPORT 64u

/* CMSDK UARTs: bits of STATE and CTRL. */
#define UART_DATA(uart) REGISTER((uart) + 0x0u)
#define UART_STATE(uart) REGISTER((uart) + 0x4u)
#define UART_CTRL(uart) REGISTER((uart) + 0x8u)
#define UART_INTCLEAR(uart) REGISTER((uart) + 0xcu)
#define UART_BAUDDIV(uart) REGISTER((uart) + 0x10u)
#define UART_TX_FULL 1u
#define UART_RX_FULL 2u
#define UART_ENABLE 3u
#define UART_RX_INTERRUPT 8u
#define UART_RX_INTERRUPT_PENDING 2u
#define LINE 0x40004000u
#define REPORT_LINE 0x40005000u
#define LINE_RX_INTERRUPT 0u
#define LINE_BIT_RATE_HZ 115200u

/* Board registers: LEDs, of which one is the enable line of the high voltage, and a counter of microseconds. */
#define LED REGISTER(0x40028000u)
#define COUNTER REGISTER(0x40028018u)
#define PRESCALE REGISTER(0x4002801cu)

/* CMSDK watchdog: a first interval makes an NMI, in which the image hangs, a second one resets. A busy host may hold
 * the emulator up for long, so these are seconds where a real board has 50 ms. */
#define WATCHDOG_LOAD REGISTER(0x40008000u)
#define WATCHDOG_CONTROL REGISTER(0x40008008u)
#define WATCHDOG_CLEAR REGISTER(0x4000800cu)
#define WATCHDOG_INTERRUPT_AND_RESET 3u

extern const uint32_t board_chance;

static uint8_t basis[BASIS_SIZE];
static struct ring incoming, outgoing, reports;
static int16_t last_output;

static void receive(void)
{
    UART_INTCLEAR(LINE) = UART_RX_INTERRUPT_PENDING;
    while (UART_STATE(LINE) & UART_RX_FULL) {
        ring_put(&incoming, (uint8_t)UART_DATA(LINE));
    }
}

__attribute__((section(".board_interrupts"), used)) const cortex_m_handler board_interrupts[CORTEX_M_INTERRUPTS] = {
    [LINE_RX_INTERRUPT] = receive,
};

static void drain(struct ring *ring, uint32_t uart)
{
    uint8_t byte;
    while (!(UART_STATE(uart) & UART_TX_FULL) && ring_take(ring, &byte)) {
        UART_DATA(uart) = byte;
    }
}

/* A line for which there is no room is left out whole: two halves would read as another. */
static void put_report(uint8_t character)
{
    static uint8_t line[LONGEST_REPORT];
    static size_t length;
    line[length++] = character;
    if (character == '\n' || length == LONGEST_REPORT) {
        ring_put_all(&reports, line, length);
        length = 0;
    }
}

void board_describe(struct tactable_configuration *configuration)
{
    *configuration = (struct tactable_configuration){
        .boot_id = next_boot_id(board_chance),
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
        .full_scales_pm = {FULL_SCALE_PM, FULL_SCALE_PM, FULL_SCALE_PM, FULL_SCALE_PM},
        .sensor_rate_mhz = 1000u * SYNTHESIS_RATE_HZ / SENSE_TURNS,
        .sensor_scale_nm_per_s2 = SENSE_SCALE_NM_PER_S2,
        .sensor_greatest = SENSE_GREATEST,
    };
}

void board_start(void)
{
    LED = 0;
    PRESCALE = CLOCK_HZ / 1000000u - 1u;
    COUNTER = 0; /* until here it counted cycles, the more the longer QEMU took to start the board */
    UART_BAUDDIV(LINE) = CLOCK_HZ / LINE_BIT_RATE_HZ;
    UART_CTRL(LINE) = UART_ENABLE | UART_RX_INTERRUPT;
    UART_BAUDDIV(REPORT_LINE) = CLOCK_HZ / LINE_BIT_RATE_HZ;
    UART_CTRL(REPORT_LINE) = UART_ENABLE;
    WATCHDOG_LOAD = CLOCK_HZ;
    WATCHDOG_CONTROL = WATCHDOG_INTERRUPT_AND_RESET;
    cortex_m_start_system_timer(CLOCK_HZ / SYNTHESIS_RATE_HZ);
    cortex_m_enable_interrupt(LINE_RX_INTERRUPT);
}

uint32_t board_time_us(void)
{
    return COUNTER;
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
    return BOARD_LINE_UP; /* this UART reports no BREAK and has no modem lines */
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
    last_output = displacements[0];
    report_outputs(displacements);
}

/* An accelerometer that is simulated: it reads a third of what the first actuator was given, at 1 kHz. */
bool board_sense(int16_t *acceleration)
{
    static uint32_t turns;
    turns++;
    *acceleration = (int16_t)(last_output / 3);
    return turns % SENSE_TURNS == 0;
}

void board_high_voltage(bool is_on)
{
    LED = is_on;
    report_high_voltage(is_on);
}

uint16_t board_high_voltage_dv(void)
{
    return 0;
}

void board_feed_watchdog(void)
{
    WATCHDOG_CLEAR = 1;
}

void board_end_turn(void)
{
    drain(&outgoing, LINE);
    report_turn(UART_STATE(REPORT_LINE) & UART_RX_FULL ? (uint8_t)UART_DATA(REPORT_LINE) : 0, put_report);
    drain(&reports, REPORT_LINE);
    report_wait();
}
