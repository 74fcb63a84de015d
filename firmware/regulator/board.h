// What is at the board's pins: the one file to adapt to a bench. Pure: volts and counts in and out, no register.
//
//   set-point (kPa) -> the valve's input (V) -> the Teensy's DAC (counts), through an amplifier outside
//   the sensor (V) -> a divider -> the Teensy's ADC (counts) -> pressure (kPa), and whether that can be true
#pragma once

#include <stdint.h>

#include "core.h"

namespace softarm {

// Pressure at the valve as a function of the voltage at its set-point input: a straight line between two points.
struct Valve {
  float p_min_kpa;  // gauge, commanded by v_min
  float p_max_kpa;
  float v_min;
  float v_max;
  float v_vent;  // at which the muscle is open to the room; of a vacuum-capable valve 0 V is -100 kPa and no vent
};

// What stands between DAC and valve. The DAC alone reaches 3.3 V; a board in reset drives nothing, which a resistor to
// ground at the DAC's pin makes 0 V: the valve then gets `v_at_zero`.
struct Amplifier {
  float v_at_zero;
  float gain;
};

// The pressure sensor, or the valve's own feedback output: a straight line between two points, and the voltages
// at which it is believed. Choose those so that a torn wire (0 V behind the divider) and a short lie outside.
struct Sensor {
  float p_min_kpa;  // gauge, said by v_min
  float p_max_kpa;
  float v_min;
  float v_max;
  float v_believed_min;
  float v_believed_max;
  float divider;  // volts at the Teensy's pin for one volt of the sensor
};

// Festo VPPI, by its range. The first has sources: set-point and feedback 0 to 10 V over -1 to +1 bar, 0 bar at 5 V.
// The second is how one of 0 to 2 bar would have it, and is not verified: it cannot go below the room's pressure.
constexpr Valve kVppiMinus1To1Bar = {-100.0F, 100.0F, 0.0F, 10.0F, 5.0F};
constexpr Valve kVppi0To2Bar = {0.0F, 200.0F, 0.0F, 10.0F, 0.0F};

// ---- the bench ----

constexpr Valve kValve = kVppiMinus1To1Bar;
// 4.90 to 6.22 V, -2 to 24.4 kPa: whatever the program does the muscle gets no more, and next to nothing in reset.
constexpr Amplifier kAmplifier = {4.9F, 0.4F};
// The valve's feedback, believed from -20 to 60 kPa, through 20 kOhm and 10 kOhm.
constexpr Sensor kSensor = {-100.0F, 100.0F, 0.0F, 10.0F, 4.0F, 8.0F, 1.0F / 3.0F};

constexpr uint8_t kRelayPin = 2U;  // high closes; a resistor to ground at the pin opens it while the board is in reset
constexpr uint8_t kLedPin = 13U;   // on while armed
constexpr uint32_t kWatchdogMs = 20U;  // a loop takes well under 1 ms

// ---- arithmetic ----

constexpr float kSupplyV = 3.3F;       // of DAC and ADC alike
constexpr float kCountsMax = 4095.0F;  // 12 bits

constexpr float clamp(float value, float low, float high) {
  return (value < low) ? low : ((value > high) ? high : value);
}

// The voltage at the valve's input for a set-point; beyond the valve's range its end.
constexpr float valve_volts(const Valve& valve, float kpa) {
  return valve.v_min + (clamp(kpa, valve.p_min_kpa, valve.p_max_kpa) - valve.p_min_kpa) *
                           (valve.v_max - valve.v_min) / (valve.p_max_kpa - valve.p_min_kpa);
}

// The DAC's counts for a voltage at the valve; beyond the amplifier's reach its end.
constexpr uint16_t dac_counts(const Amplifier& amplifier, float volts) {
  return static_cast<uint16_t>(
      clamp((volts - amplifier.v_at_zero) / amplifier.gain / kSupplyV, 0.0F, 1.0F) * kCountsMax + 0.5F);
}

// What the DAC is to say: the set-point of an armed board, else vent.
inline uint16_t output_counts(const Valve& valve, const Amplifier& amplifier, bool armed, float kpa) {
  return dac_counts(amplifier, armed ? valve_volts(valve, kpa) : valve.v_vent);
}

// What the ADC's counts mean.
inline Reading reading_of(const Sensor& sensor, uint16_t counts) {
  const float volts = static_cast<float>(counts) / kCountsMax * kSupplyV / sensor.divider;
  const float kpa = sensor.p_min_kpa + (volts - sensor.v_min) * (sensor.p_max_kpa - sensor.p_min_kpa) /
                                           (sensor.v_max - sensor.v_min);
  return {kpa, (volts >= sensor.v_believed_min) && (volts <= sensor.v_believed_max)};
}

// A bench that cannot be right does not compile.
constexpr float kReachedV = kAmplifier.v_at_zero + kAmplifier.gain * kSupplyV;
constexpr float kCountV = kAmplifier.gain * kSupplyV / kCountsMax;
static_assert(valve_volts(kValve, kSetPointMaxKpa) <= kReachedV, "the amplifier does not reach 20 kPa");
static_assert(kValve.v_vent >= kAmplifier.v_at_zero && kValve.v_vent <= kReachedV,
              "the amplifier does not reach v_vent");
static_assert(kAmplifier.v_at_zero <= kValve.v_vent + kCountV, "a board in reset would inflate the muscle");
static_assert(valve_volts(kValve, kVentKpa) <= kValve.v_vent + kCountV &&
                  valve_volts(kValve, kVentKpa) >= kValve.v_vent - kCountV,
              "v_vent is not where 0 kPa lies on the valve's line");
static_assert(kSensor.v_believed_min > 0.0F && kSensor.v_believed_max * kSensor.divider < kSupplyV,
              "a torn wire or a short would be believed");
static_assert(kWatchdogMs >= 5U && kWatchdogMs <= 50U, "a hung loop has to vent as soon as a silent host");

}  // namespace softarm
