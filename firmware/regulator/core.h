// What the regulator's board does, without a board: bytes, the time and the sensor go in; answers, a set-point and a
// relay come out. The rules are those of docs/wires.md, section Regulator, and are called by its numbers.
//
// No heap, no exceptions, no clock, no input or output of its own; compiled for the Teensy and for the tests alike.
#pragma once

#include <stddef.h>
#include <stdint.h>

#include "frames.h"

namespace softarm {

constexpr float kVentKpa = 0.0F;          // gauge: the muscle is open to the room
constexpr float kSetPointMinKpa = -0.7F;  // accepted set-points
constexpr float kSetPointMaxKpa = 20.0F;
constexpr uint16_t kTimeToLiveMaxMs = 250U;
constexpr uint32_t kRelayOpenUs = 1000000U;  // an opened relay stays open so long: longer than any braking ramp

// Bits of a state's faults.
constexpr uint16_t kFaultTimeToLive = 1U << 0U;
constexpr uint16_t kFaultToken = 1U << 1U;
constexpr uint16_t kFaultRange = 1U << 2U;
constexpr uint16_t kFaultSensor = 1U << 3U;
constexpr uint16_t kFaultSequence = 1U << 4U;

// What the pressure sensor reads. What is not finite is said as 0 kPa, outside the span.
struct Reading {
  float kpa;  // gauge
  bool in_span;
};

class Core {
 public:
  using DrawToken = uint32_t (*)();  // 32 random bits, new at each call

  explicit Core(DrawToken draw_token) : draw_token_(draw_token) {}

  // Lets time pass; to be called all the time, and before the outputs are used. `now_us` wraps every 71 minutes, which
  // goes unnoticed; one that goes back counts as a wrap, and vents.
  void watch(uint32_t now_us);

  // Takes a byte of the line; returns how many bytes of `answer`, which has room for kFrameMax, are to be sent.
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
  size_t greet(uint32_t sequence, uint8_t* answer);
  uint16_t refusal(const Command& command, uint32_t sequence) const;
  void obey(const Command& command, uint32_t sequence);
  size_t tell(const Reading& sensor, uint8_t* answer);
  void disarm();
  bool fresh() const;
  void lead_relay();
  void open_relay();

  DrawToken draw_token_;
  Deframer deframer_;
  bool started_ = false;    // the clock was said once
  uint32_t clock_us_ = 0U;  // as it was said last
  uint64_t now_us_ = 0U;    // since it was said first; never wraps
  bool greeted_ = false;
  uint32_t token_ = 0U;
  uint32_t newest_ = 0U;    // the sequence of the last hello or accepted command
  uint32_t accepted_ = 0U;  // of the last accepted command since the hello
  uint32_t said_ = 0U;      // our own count
  bool may_arm_ = false;    // a disarmed command was accepted
  bool armed_ = false;
  float set_point_kpa_ = kVentKpa;
  uint16_t faults_ = 0U;
  uint64_t heard_us_ = 0U;  // when the last command was accepted
  uint32_t live_us_ = 0U;   // its time to live; 0: there was none
  bool relay_closed_ = false;
  uint64_t opened_us_ = 0U;
};

}  // namespace softarm
