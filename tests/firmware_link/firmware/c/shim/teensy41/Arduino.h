// What board.cpp uses of Teensy's Arduino core, declared and no more: for a syntax check where the core is not installed.
#pragma once

#include <stddef.h>
#include <stdint.h>

#define OUTPUT 1
#define HIGH 1
#define LOW 0
constexpr uint8_t A0 = 14;

void pinMode(uint8_t pin, uint8_t mode);
void digitalWriteFast(uint8_t pin, uint8_t value);
int analogRead(uint8_t pin);
void analogWrite(uint8_t pin, int value);
void analogWriteFrequency(uint8_t pin, float frequency_hz);
uint32_t analogWriteResolution(uint32_t bits);
uint32_t micros();
uint32_t millis();
void noInterrupts();
void interrupts();

class usb_serial_class {
public:
    void begin(long bit_rate_hz);
    int available();
    int read();
    int availableForWrite();
    size_t write(const uint8_t *bytes, size_t length);
    void send_now();
    uint8_t dtr();
};
extern usb_serial_class Serial;
extern volatile uint8_t usb_configuration;

extern volatile uint32_t CCM_CCGR5, CCM_CCGR6, SRC_SRSR;
extern volatile uint32_t TRNG_MCTL, TRNG_ENT0;
extern volatile uint32_t WDOG3_CS, WDOG3_CNT, WDOG3_TOVAL;
#define CCM_CCGR_ON 3u
#define CCM_CCGR5_WDOG3(n) ((uint32_t)(((n) & 3u) << 4))
#define CCM_CCGR6_TRNG(n) ((uint32_t)(((n) & 3u) << 12))
#define TRNG_MCTL_SAMP_MODE(n) ((uint32_t)((n) & 3u))
#define TRNG_MCTL_RST_DEF ((uint32_t)(1u << 6))
#define TRNG_MCTL_ENT_VAL ((uint32_t)(1u << 10))
#define TRNG_MCTL_ERR ((uint32_t)(1u << 12))
#define TRNG_MCTL_PRGM ((uint32_t)(1u << 16))
#define WDOG_CS_UPDATE ((uint32_t)(1u << 5))
#define WDOG_CS_EN ((uint32_t)(1u << 7))
#define WDOG_CS_CLK(n) ((uint32_t)(((n) & 3u) << 8))
#define WDOG_CS_ULK ((uint32_t)(1u << 11))
#define WDOG_CS_CMD32EN ((uint32_t)(1u << 13))
