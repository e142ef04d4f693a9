/* The parts of a Cortex-M3 or M4 that every chip has: interrupt mask, system timer, interrupt controller. */
#ifndef TACTABLE_CORTEX_M_H
#define TACTABLE_CORTEX_M_H

#include <stdint.h>

#define REGISTER(address) (*(volatile uint32_t *)(address))

/* Chip interrupts that a board may name; more than any of ours has in use. */
#define CORTEX_M_INTERRUPTS 48u

typedef void (*cortex_m_handler)(void);

/* Entries 16 and up of the vector table; a board points its own at functions before main. */
extern const cortex_m_handler board_interrupts[CORTEX_M_INTERRUPTS];

/* Of the system timer: below the serial line, whose bytes do not wait. */
#define CORTEX_M_SAMPLE_PRIORITY 0x80u

static inline void cortex_m_hold_system_timer(void)
{
    __asm__ volatile("msr basepri, %0" ::"r"(CORTEX_M_SAMPLE_PRIORITY) : "memory");
}

static inline void cortex_m_release_system_timer(void)
{
    __asm__ volatile("msr basepri, %0" ::"r"(0) : "memory");
}

static inline void cortex_m_wait_for_interrupt(void)
{
    __asm__ volatile("wfi" ::: "memory");
}

static inline void cortex_m_enable_interrupt(uint32_t number)
{
    REGISTER(0xe000e100u + 4u * (number / 32u)) = 1u << number % 32u;
}

/* The system timer interrupts every `cycles` of the processor's clock. */
static inline void cortex_m_start_system_timer(uint32_t cycles)
{
    *(volatile uint8_t *)0xe000ed23u = CORTEX_M_SAMPLE_PRIORITY;
    REGISTER(0xe000e014u) = cycles - 1u;
    REGISTER(0xe000e018u) = 0;
    REGISTER(0xe000e010u) = 7u;
}

static inline void cortex_m_stop_system_timer(void)
{
    REGISTER(0xe000e010u) = 0;
}

#endif
