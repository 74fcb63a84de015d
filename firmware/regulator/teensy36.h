// Watchdog and random numbers of a Teensy 3.6 (NXP MK66FX1M0), for which Teensyduino has no functions.
#pragma once

#include <stdint.h>

namespace softarm {

// Starts the watchdog: without feeding the board resets itself, which releases the pins of relay and DAC.
void start_watchdog(uint32_t milliseconds);

void feed_watchdog();

// Returns 32 unpredictable bits without waiting.
uint32_t draw_token();

}  // namespace softarm
