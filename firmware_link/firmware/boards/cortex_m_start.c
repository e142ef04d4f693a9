/* From reset to the main loop on a bare Cortex-M. */
#include <stddef.h>
#include <string.h>

#include "board.h"
#include "cortex_m.h"
#include "main_loop.h"

/* Defined by the linker script. */
extern uint8_t data_load[], data_start[], data_end[], bss_start[], bss_end[], stack_top[];

int main(void)
{
    main_loop_start();
    for (;;) {
        main_loop_turn();
    }
}

void cortex_m_reset(void);

void cortex_m_reset(void)
{
    memcpy(data_start, data_load, (size_t)(data_end - data_start));
    memset(bss_start, 0, (size_t)(bss_end - bss_start));
    main();
}

/* A fault of the program: the supply goes off, nothing more is done, and the hardware watchdog resets the board. */
static void hang(void)
{
    board_high_voltage(false);
    for (;;) {
    }
}

__attribute__((section(".vectors"), used)) static const struct {
    void *stack;
    cortex_m_handler exceptions[15];
} vectors = {
    .stack = stack_top,
    .exceptions = {
        cortex_m_reset, hang, hang, hang, hang, hang, hang, hang, hang, hang, hang, hang, hang, hang, main_loop_sample,
    },
};
