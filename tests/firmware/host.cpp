// The firmware's core as a shared library, for ctypes.
#include <stddef.h>
#include <stdint.h>

#include "../../firmware/regulator/board.h"
#include "../../firmware/regulator/core.h"

using softarm::Core;

extern "C" {

Core* core_new(uint32_t (*draw_token)()) { return new Core(draw_token); }

void core_delete(Core* core) { delete core; }

void core_watch(Core* core, uint32_t now_us) { core->watch(now_us); }

// Processes `data` at one instant and returns the number of bytes in `answers`, which must hold one frame more than
// there are zeros in `data`.
size_t core_take(Core* core, const uint8_t* data, size_t length, uint32_t now_us, float kpa, bool in_span, uint8_t* answers) {
  size_t said = 0U;
  for (size_t i = 0U; i < length; ++i) {
    said += core->take(data[i], now_us, {kpa, in_span}, answers + said);
  }
  return said;
}

bool core_armed(const Core* core) { return core->armed(); }
bool core_relay_closed(const Core* core) { return core->relay_closed(); }
float core_set_point_kpa(const Core* core) { return core->set_point_kpa(); }
uint32_t core_accepted_sequence(const Core* core) { return core->accepted_sequence(); }
uint16_t core_faults(const Core* core) { return core->faults(); }

uint16_t frames_crc16(const uint8_t* data, size_t length) { return softarm::crc16(data, length); }
size_t frames_stuff(const uint8_t* data, size_t length, uint8_t* out) { return softarm::stuff(data, length, out); }
size_t frames_unstuff(uint8_t* block, size_t length) { return softarm::unstuff(block, length); }

softarm::Deframer* deframer_new() { return new softarm::Deframer; }
void deframer_delete(softarm::Deframer* deframer) { delete deframer; }
size_t deframer_take(softarm::Deframer* deframer, uint8_t byte) { return deframer->take(byte); }
const uint8_t* deframer_body(const softarm::Deframer* deframer) { return deframer->body(); }

uint16_t board_output(bool vacuum, bool armed, float kpa) {
  constexpr softarm::Amplifier whole = {0.0F, 10.0F / softarm::kSupplyV};  // 0 to 10 V
  return softarm::output_counts(vacuum ? softarm::kVppiMinus1To1Bar : softarm::kVppi0To2Bar, whole, armed, kpa);
}

uint16_t board_own_output(bool armed, float kpa) {
  return softarm::output_counts(softarm::kValve, softarm::kAmplifier, armed, kpa);
}

float board_own_volts(uint16_t counts) {
  return softarm::kAmplifier.v_at_zero + softarm::kAmplifier.gain * softarm::kSupplyV * counts / softarm::kCountsMax;
}

float board_reading_kpa(uint16_t counts) { return softarm::reading_of(softarm::kSensor, counts).kpa; }
bool board_reading_in_span(uint16_t counts) { return softarm::reading_of(softarm::kSensor, counts).in_span; }
}
