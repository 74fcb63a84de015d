// Framing of the serial line as docs/wires.md has it: COBS(body, CRC-16 of the body, low byte first), then a zero.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace softarm {

constexpr size_t kBodyMax = 21U;              // the longest body of version 1: a command, a state
constexpr size_t kBlockMax = kBodyMax + 3U;   // with its CRC and the one byte that stuffing adds
constexpr size_t kFrameMax = kBlockMax + 1U;  // with its zero

// CRC-16/IBM-3740: polynomial 1021h, initial FFFFh, nothing reflected, no final XOR.
uint16_t crc16(const uint8_t* data, size_t length);

// Stuffs up to 253 bytes into `out`, which has room for one more; returns how many were written, none of them zero.
size_t stuff(const uint8_t* data, size_t length, uint8_t* out);

// Takes the stuffing out of a block without zeros, in place; returns what is left, 0 when a run points behind the end.
size_t unstuff(uint8_t* block, size_t length);

// Puts a body of up to kBodyMax bytes on the line: writes up to kFrameMax bytes, returns how many.
size_t frame(const uint8_t* body, size_t length, uint8_t* out);

// Cuts a stream of bytes into the bodies of good frames. What does not fit is dropped up to the next zero byte; a block
// that is longer than any of ours cannot become one, so that no more than kBlockMax bytes of it are kept.
class Deframer {
 public:
  // Takes a byte; returns how long the body is that it completes, else 0. `body` holds it until the next byte.
  size_t take(uint8_t byte);

  const uint8_t* body() const { return block_; }

 private:
  uint8_t block_[kBlockMax] = {};
  size_t length_ = 0U;
  bool lost_ = false;  // too much without a zero
};

}  // namespace softarm
