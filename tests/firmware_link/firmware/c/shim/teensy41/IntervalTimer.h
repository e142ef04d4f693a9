// As Arduino.h beside it.
#pragma once

class IntervalTimer {
public:
    bool begin(void (*function)(), float period_us);
};
