#include "core.h"

#include <string.h>

namespace softarm {

namespace {

constexpr uint8_t kVersion = 1U;
constexpr uint8_t kHello = 0x01U;
constexpr uint8_t kWelcome = 0x81U;
constexpr uint8_t kCommand = 0x02U;
constexpr uint8_t kState = 0x82U;

// Version, type, sequence and time.
constexpr size_t kHeadBytes = 10U;
constexpr size_t kCommandBytes = kHeadBytes + 11U;
constexpr uint8_t kArmed = 1U << 0U;
constexpr uint16_t kRefusals = kFaultToken | kFaultRange | kFaultSequence;

static_assert(sizeof(float) == 4U, "set-points and readings are IEEE 754 single");
static_assert(kCommandBytes == kBodyMax, "a command is the longest body");

uint16_t read16(const uint8_t* at) { return static_cast<uint16_t>(at[0] | (at[1] << 8U)); }

uint32_t read32(const uint8_t* at) {
  return static_cast<uint32_t>(read16(at)) | (static_cast<uint32_t>(read16(at + 2)) << 16U);
}

float read_float(const uint8_t* at) {
  const uint32_t bits = read32(at);
  float value = 0.0F;
  (void)memcpy(&value, &bits, sizeof value);
  return value;
}

// Writer of a body, low bytes first.
class Writer {
 public:
  Writer(uint8_t type, uint32_t sequence, uint32_t clock_us) {
    u8(kVersion);
    u8(type);
    u32(sequence);
    u32(clock_us);
  }

  void u8(uint8_t value) {
    body_[length_] = value;
    ++length_;
  }

  void u16(uint16_t value) {
    u8(static_cast<uint8_t>(value & 0xFFU));
    u8(static_cast<uint8_t>(value >> 8U));
  }

  void u32(uint32_t value) {
    u16(static_cast<uint16_t>(value & 0xFFFFU));
    u16(static_cast<uint16_t>(value >> 16U));
  }

  void f32(float value) {
    uint32_t bits = 0U;
    (void)memcpy(&bits, &value, sizeof bits);
    u32(bits);
  }

  size_t frame_into(uint8_t* out) const { return frame(body_, length_, out); }

 private:
  uint8_t body_[kBodyMax] = {};
  size_t length_ = 0U;
};

// Returns whether a sequence is ahead by 1 to 2^31 - 1, modulo 2^32.
bool is_newer(uint32_t sequence, uint32_t than) {
  const uint32_t ahead = sequence - than;
  return (ahead > 0U) && (ahead < 0x80000000U);
}

// Returns whether a value is in a range; NaN is in none.
bool within(float value, float low, float high) { return (value >= low) && (value <= high); }

}  // namespace

void Core::watch(uint32_t now_us) {
  pass(now_us);
  update_relay();
}

size_t Core::take(uint8_t byte, uint32_t now_us, const Reading& sensor, uint8_t* answer) {
  pass(now_us);
  const size_t length = deframer_.take(byte);
  const uint8_t* body = deframer_.body();
  size_t answered = 0U;
  if ((length >= kHeadBytes) && (body[0] == kVersion)) {
    const uint32_t sequence = read32(body + 2);
    if ((body[1] == kHello) && (length == kHeadBytes)) {
      answered = welcome(sequence, answer);
    } else if ((body[1] == kCommand) && (length == kCommandBytes)) {
      const uint8_t* fields = body + kHeadBytes;
      execute({read32(fields), read16(fields + 4), (fields[6] & kArmed) != 0U, read_float(fields + 7)}, sequence);
      answered = report(sensor, answer);
    } else {
      // Rule 2: other types, other lengths and messages of a device are not answered.
    }
  }
  update_relay();
  return answered;
}

// Rule 5. Extends the 32-bit clock to 64 bits, so that only this function handles its wrap.
void Core::pass(uint32_t now_us) {
  now_us_ += started_ ? static_cast<uint32_t>(now_us - clock_us_) : 0U;
  clock_us_ = now_us;
  started_ = true;
  if (armed_ && !fresh()) {
    disarm();
    may_arm_ = false;
    faults_ |= kFaultTimeToLive;
  }
}

// Rule 1.
size_t Core::welcome(uint32_t sequence, uint8_t* answer) {
  disarm();
  may_arm_ = false;
  accepted_ = 0U;
  newest_ = sequence;
  live_us_ = 0U;
  token_ = draw_token_();
  greeted_ = true;
  ++sent_;
  Writer message(kWelcome, sent_, clock_us_);
  message.u32(token_);
  return message.frame_into(answer);
}

// Rule 3: returns the fault bit of a rejected command, or 0.
uint16_t Core::refusal(const Command& command, uint32_t sequence) const {
  if (!greeted_ || (command.token != token_)) {
    return kFaultToken;
  }
  if (!is_newer(sequence, newest_)) {
    return kFaultSequence;
  }
  const bool in_range = within(command.kpa, kSetPointMinKpa, kSetPointMaxKpa) && (command.time_to_live_ms >= 1U) &&
                        (command.time_to_live_ms <= kTimeToLiveMaxMs);
  return in_range ? 0U : kFaultRange;
}

// Rules 3 and 4.
void Core::execute(const Command& command, uint32_t sequence) {
  const uint16_t rejected = refusal(command, sequence);
  faults_ = static_cast<uint16_t>((faults_ & ~static_cast<uint32_t>(kRefusals)) | rejected);
  if (rejected != 0U) {
    return;
  }
  newest_ = sequence;
  accepted_ = sequence;
  accepted_us_ = now_us_;
  live_us_ = static_cast<uint32_t>(command.time_to_live_ms) * 1000U;
  set_point_kpa_ = command.kpa;
  if (!command.armed) {
    disarm();
    may_arm_ = true;
    faults_ = static_cast<uint16_t>(faults_ & ~static_cast<uint32_t>(kFaultTimeToLive));
  } else if (may_arm_) {
    armed_ = true;
  } else {
    // Rule 4: a disarmed command must come first.
  }
}

// Rules 2, 6 and 7.
size_t Core::report(const Reading& sensor, uint8_t* answer) {
  const bool finite = within(sensor.kpa, -3.4e38F, 3.4e38F);
  const bool valid = finite && sensor.in_span;
  ++sent_;
  Writer state(kState, sent_, clock_us_);
  state.u32(accepted_);
  state.u8(armed_ ? kArmed : 0U);
  state.u16(static_cast<uint16_t>(faults_ | (valid ? 0U : kFaultSensor)));
  state.f32(finite ? sensor.kpa : 0.0F);
  return state.frame_into(answer);
}

void Core::disarm() {
  if (armed_) {
    open_relay();
  }
  armed_ = false;
}

// Returns whether the last accepted command's time to live has not expired.
bool Core::fresh() const { return (now_us_ - accepted_us_) < live_us_; }

// Rule 9: the relay is closed while accepted commands arrive and no fault is latched.
void Core::update_relay() {
  if (!fresh() || ((faults_ & kFaultTimeToLive) != 0U)) {
    open_relay();
  } else if (!relay_closed_ && ((now_us_ - opened_us_) >= kRelayOpenUs)) {
    relay_closed_ = true;
  } else {
    // The state does not change.
  }
}

void Core::open_relay() {
  if (relay_closed_) {
    relay_closed_ = false;
    opened_us_ = now_us_;
  }
}

}  // namespace softarm
