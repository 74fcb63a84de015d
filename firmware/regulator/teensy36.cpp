#include "teensy36.h"

#include <Arduino.h>

namespace softarm {

namespace {

// Teensyduino has no header for the random number generator (RNGA, K66 reference manual chapter 38).
constexpr uint32_t kRngClock = 1UL << 9U;  // of SIM_SCGC6
constexpr uint32_t kRngGo = 1U << 0U;
constexpr uint32_t kRngHighAssurance = 1U << 1U;
constexpr uint32_t kRngSleep = 1U << 4U;
constexpr uint32_t kRngLevel = 0xFF00U;  // of its status: words that are ready

volatile uint32_t& rng_register(uintptr_t offset) {
  return *reinterpret_cast<volatile uint32_t*>(0x40029000UL + offset);
}

}  // namespace

void start_watchdog(uint32_t milliseconds) {
  noInterrupts();
  WDOG_UNLOCK = WDOG_UNLOCK_SEQ1;
  WDOG_UNLOCK = WDOG_UNLOCK_SEQ2;
  // Wait for a bus cycle.
  delayMicroseconds(1);
  WDOG_TOVALH = static_cast<uint16_t>(milliseconds >> 16U);
  WDOG_TOVALL = static_cast<uint16_t>(milliseconds & 0xFFFFU);
  WDOG_PRESC = 0;
  // Clocked by its own 1 kHz oscillator; without ALLOWUPDATE it cannot be disabled again.
  WDOG_STCTRLH = static_cast<uint16_t>(WDOG_STCTRLH_WDOGEN | WDOG_STCTRLH_WAITEN | WDOG_STCTRLH_STOPEN);
  interrupts();
}

void feed_watchdog() {
  // The two writes must follow each other directly.
  noInterrupts();
  WDOG_REFRESH = 0xA602;
  WDOG_REFRESH = 0xB480;
  interrupts();
}

// The manual does not guarantee the generator's quality alone, so the arrival time of the hello in us is mixed in.
uint32_t draw_token() {
  static uint32_t pool = 0U;
  SIM_SCGC6 |= kRngClock;
  rng_register(0x0U) = (rng_register(0x0U) & ~kRngSleep) | kRngHighAssurance | kRngGo;
  for (uint8_t round = 0U; round < 4U; ++round) {
    const bool ready = (rng_register(0x4U) & kRngLevel) != 0U;
    pool ^= micros() ^ (ready ? rng_register(0xCU) : 0U);
    pool *= 0x9E3779B1U;
    pool ^= pool >> 15U;
    // A word needs 256 cycles of the bus clock.
    delayMicroseconds(3);
  }
  return pool;
}

}  // namespace softarm
