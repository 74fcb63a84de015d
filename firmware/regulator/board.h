// Circuit at the board's pins: the only file to adapt to a bench. Pure: volts and counts in and out, no registers.
//
//   set-point (kPa) -> the valve's input (V) -> the Teensy's DAC (counts), through an amplifier outside
//   the sensor (V) -> a divider -> the Teensy's ADC (counts) -> pressure (kPa), and whether it is valid
#pragma once

#include <stdint.h>

#include "core.h"

namespace softarm {

// Pressure of the valve as a function of the voltage at its set-point input: a line between two points (gauge).
// At v_vent the muscle is open to the air; 0 V at a vacuum-capable valve is -100 kPa and does not vent.
struct Valve {
  float p_min_kpa;
  float p_max_kpa;
  float v_min;
  float v_max;
  float v_vent;
};

// Amplifier between DAC and valve. The DAC reaches 3.3 V. A board in reset drives nothing, and a resistor to ground at
// the DAC's pin makes that 0 V: the valve then receives `v_at_zero`.
struct Amplifier {
  float v_at_zero;
  float gain;
};

// The pressure sensor, or the valve's feedback output: a line between two points (gauge), and the range of valid
// voltages. Choose the range so that a broken wire (0 V behind the divider) and a short circuit are outside.
// `divider` is the voltage at the Teensy's pin for one volt of the sensor.
struct Sensor {
  float p_min_kpa;
  float p_max_kpa;
  float v_min;
  float v_max;
  float v_valid_min;
  float v_valid_max;
  float divider;
};

// Festo VPPI, by its range. The first is documented: set-point and feedback 0 to 10 V over -1 to +1 bar, 0 bar at 5 V.
// The second, for 0 to 2 bar, is not verified; it cannot go below ambient pressure. Its feedback of 0 V at vent reads as
// a broken wire: give it a sensor of its own.
constexpr Valve kVppiMinus1To1Bar = {-100.0F, 100.0F, 0.0F, 10.0F, 5.0F};
constexpr Valve kVppi0To2Bar = {0.0F, 200.0F, 0.0F, 10.0F, 0.0F};

// ---- the bench ----

constexpr Valve kValve = kVppiMinus1To1Bar;
// 4.90 to 6.22 V, -2 to 24.4 kPa: the program cannot exceed this, and in reset the pressure is almost zero.
constexpr Amplifier kAmplifier = {4.9F, 0.4F};
// The valve's feedback, valid from -20 to 60 kPa, through 20 kOhm and 10 kOhm.
constexpr Sensor kSensor = {-100.0F, 100.0F, 0.0F, 10.0F, 4.0F, 8.0F, 1.0F / 3.0F};

// High closes the relay; a resistor to ground at the pin opens it while the board is in reset.
constexpr uint8_t kRelayPin = 2U;
// The LED is on while armed.
constexpr uint8_t kLedPin = 13U;
// A loop takes well under 1 ms.
constexpr uint32_t kWatchdogMs = 20U;

// ---- arithmetic ----

// Supply of DAC and ADC, both with 12 bits.
constexpr float kSupplyV = 3.3F;
constexpr float kCountsMax = 4095.0F;

constexpr float clamp(float value, float low, float high) {
  return (value < low) ? low : ((value > high) ? high : value);
}

// Returns the voltage at the valve's input for a set-point, limited to the valve's range.
constexpr float valve_volts(const Valve& valve, float kpa) {
  return valve.v_min + (clamp(kpa, valve.p_min_kpa, valve.p_max_kpa) - valve.p_min_kpa) *
                           (valve.v_max - valve.v_min) / (valve.p_max_kpa - valve.p_min_kpa);
}

// Returns the DAC's counts for a voltage at the valve, limited to the amplifier's range.
constexpr uint16_t dac_counts(const Amplifier& amplifier, float volts) {
  return static_cast<uint16_t>(
      clamp((volts - amplifier.v_at_zero) / amplifier.gain / kSupplyV, 0.0F, 1.0F) * kCountsMax + 0.5F);
}

// Returns the DAC's counts for the set-point of an armed board, else for vent.
inline uint16_t output_counts(const Valve& valve, const Amplifier& amplifier, bool armed, float kpa) {
  return dac_counts(amplifier, armed ? valve_volts(valve, kpa) : valve.v_vent);
}

// Returns the reading for the ADC's counts.
inline Reading reading_of(const Sensor& sensor, uint16_t counts) {
  const float volts = static_cast<float>(counts) / kCountsMax * kSupplyV / sensor.divider;
  const float kpa = sensor.p_min_kpa + (volts - sensor.v_min) * (sensor.p_max_kpa - sensor.p_min_kpa) /
                                           (sensor.v_max - sensor.v_min);
  return {kpa, (volts >= sensor.v_valid_min) && (volts <= sensor.v_valid_max)};
}

// An inconsistent bench does not compile.
constexpr float kReachedV = kAmplifier.v_at_zero + kAmplifier.gain * kSupplyV;
constexpr float kCountV = kAmplifier.gain * kSupplyV / kCountsMax;
static_assert(valve_volts(kValve, kSetPointMaxKpa) <= kReachedV, "the amplifier does not reach 20 kPa");
static_assert(kValve.v_vent >= kAmplifier.v_at_zero && kValve.v_vent <= kReachedV,
              "the amplifier does not reach v_vent");
static_assert(kAmplifier.v_at_zero <= kValve.v_vent + kCountV, "a board in reset would inflate the muscle");
static_assert(valve_volts(kValve, kVentKpa) <= kValve.v_vent + kCountV &&
                  valve_volts(kValve, kVentKpa) >= kValve.v_vent - kCountV,
              "v_vent is not the voltage of 0 kPa on the valve's line");
static_assert(kSensor.v_valid_min > 0.0F && kSensor.v_valid_max * kSensor.divider < kSupplyV,
              "a broken wire or a short circuit would read as valid");
static_assert(kWatchdogMs >= 5U && kWatchdogMs <= 50U, "a hung loop must vent as soon as a silent host does");

}  // namespace softarm
