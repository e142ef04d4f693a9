#include "main_loop.h"

#include "board.h"
#include "device_time.h"

#define READ_SIZE 64u

struct tactable_device the_device;

static struct wide_clock wide_clock;

static void send(void *context, const uint8_t *frame, size_t length)
{
    (void)context;
    board_send(frame, length);
}

static void hold_samples(void *context)
{
    (void)context;
    board_hold_samples();
}

static void release_samples(void *context)
{
    (void)context;
    board_release_samples();
}

static void follow_line(uint64_t now_us)
{
    switch (board_line()) {
    case BOARD_LINE_BREAK:
        tactable_device_emergency_stop(&the_device, now_us);
        break;
    case BOARD_LINE_HUNG_UP:
        tactable_device_hang_up(&the_device, now_us);
        break;
    case BOARD_LINE_UP:
        break;
    }
}

/* Feeds the watchdog only if main loop, synthesis and clock have all advanced since the last time; this turn shows the
 * first of the three. A clock that stands still would hold every lease for ever. */
static void feed_watchdog(uint64_t now_us)
{
    static uint32_t samples;
    static uint64_t fed_us;
    if (the_device.synthesis.samples != samples && now_us != fed_us) {
        samples = the_device.synthesis.samples;
        fed_us = now_us;
        board_feed_watchdog();
    }
}

void main_loop_start(void)
{
    static const struct tactable_hooks hooks = {NULL, send, hold_samples, release_samples};
    static struct tactable_configuration configuration;
    board_describe(&configuration);
    tactable_device_start(&the_device, &configuration, &hooks);
    board_start();
}

void main_loop_turn(void)
{
    uint8_t bytes[READ_SIZE];
    const uint64_t now_us = wide_clock_read(&wide_clock, board_time_us());
    the_device.high_voltage_dv = board_high_voltage_dv();
    follow_line(now_us);
    tactable_device_receive(&the_device, bytes, board_read(bytes, sizeof bytes), now_us);
    board_high_voltage(tactable_device_allows_high_voltage(&the_device));
    feed_watchdog(now_us);
    board_end_turn();
}

void main_loop_sample(void)
{
    int16_t outputs[TACTABLE_ACTUATORS], acceleration;
    /* Before the outputs change: the sample belongs to those of before. */
    if (board_sense(&acceleration)) {
        tactable_device_sense(&the_device, acceleration);
    }
    tactable_device_sample(&the_device, outputs);
    tactable_device_linearise(&the_device, outputs);
    board_write_outputs(outputs);
}
