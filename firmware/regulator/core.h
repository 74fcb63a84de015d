// Logic of the regulator board: bytes, the time and the sensor go in; answers, a set-point and a relay state come out.
// Comments refer to the numbered rules of docs/reference/wires.md, section Regulator.
//
// No heap, no exceptions, no clock and no I/O; compiled for the Teensy and for the tests.
#pragma once

#include <stddef.h>
#include <stdint.h>

#include "frames.h"

namespace softarm {

// Gauge pressure of a muscle that is open to the air.
constexpr float kVentKpa = 0.0F;
// Accepted set-points.
constexpr float kSetPointMinKpa = -0.7F;
constexpr float kSetPointMaxKpa = 20.0F;
constexpr uint16_t kTimeToLiveMaxMs = 250U;
// An opened relay stays open for longer than any braking ramp.
constexpr uint32_t kRelayOpenUs = 1000000U;

// Bits of a state's faults.
constexpr uint16_t kFaultTimeToLive = 1U << 0U;
constexpr uint16_t kFaultToken = 1U << 1U;
constexpr uint16_t kFaultRange = 1U << 2U;
constexpr uint16_t kFaultSensor = 1U << 3U;
constexpr uint16_t kFaultSequence = 1U << 4U;

// Gauge pressure of the sensor, and whether its voltage is valid. NaN and infinity are sent as 0 kPa, out of span.
struct Reading {
  float kpa;
  bool in_span;
};

class Core {
 public:
  // Returns 32 new random bits.
  using DrawToken = uint32_t (*)();

  explicit Core(DrawToken draw_token) : draw_token_(draw_token) {}

  // Advances the time. Call it continuously, and before the outputs are used. `now_us` may wrap, which it does every
  // 71 minutes; a time that goes backwards counts as a wrap, and vents.
  void watch(uint32_t now_us);

  // Accepts a received byte and returns the number of bytes to send from `answer`, which must hold kFrameMax bytes.
  size_t take(uint8_t byte, uint32_t now_us, const Reading& sensor, uint8_t* answer);

  bool armed() const { return armed_; }
  float set_point_kpa() const { return armed_ ? set_point_kpa_ : kVentKpa; }
  bool relay_closed() const { return relay_closed_; }
  uint16_t faults() const { return faults_; }
  uint32_t accepted_sequence() const { return accepted_; }

 private:
  struct Command {
    uint32_t token;
    uint16_t time_to_live_ms;
    bool armed;
    float kpa;
  };

  void pass(uint32_t now_us);
  size_t welcome(uint32_t sequence, uint8_t* answer);
  uint16_t refusal(const Command& command, uint32_t sequence) const;
  void execute(const Command& command, uint32_t sequence);
  size_t report(const Reading& sensor, uint8_t* answer);
  void disarm();
  bool fresh() const;
  void update_relay();
  void open_relay();

  DrawToken draw_token_;
  Deframer deframer_;
  bool started_ = false;
  // Last given time, and the time since the first one, which never wraps.
  uint32_t clock_us_ = 0U;
  uint64_t now_us_ = 0U;
  bool greeted_ = false;
  uint32_t token_ = 0U;
  // Sequence of the last hello or accepted command, and of the last accepted command since the hello.
  uint32_t newest_ = 0U;
  uint32_t accepted_ = 0U;
  // Count of the sent messages.
  uint32_t sent_ = 0U;
  // A disarmed command was accepted.
  bool may_arm_ = false;
  bool armed_ = false;
  float set_point_kpa_ = kVentKpa;
  uint16_t faults_ = 0U;
  // Time of the last accepted command, and its time to live; 0 without one.
  uint64_t accepted_us_ = 0U;
  uint32_t live_us_ = 0U;
  bool relay_closed_ = false;
  uint64_t opened_us_ = 0U;
};

}  // namespace softarm
