// What of a Teensy 3.6 (NXP MK66FX1M0) has no call in Teensyduino: its watchdog and its random numbers.
#pragma once

#include <stdint.h>

namespace softarm {

// From now on the board resets itself when it was not fed for so long: relay and DAC then let go of their pins.
void start_watchdog(uint32_t milliseconds);

void feed_watchdog();

// 32 bits that nobody can tell beforehand; never waits.
uint32_t draw_token();

}  // namespace softarm
