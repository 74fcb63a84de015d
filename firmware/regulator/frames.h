// Framing of the serial line (docs/reference/wires.md): COBS(body, CRC-16 of the body, low byte first), then a zero.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace softarm {

// Longest body of version 1 (command and state); with CRC and stuffing; with the final zero.
constexpr size_t kBodyMax = 21U;
constexpr size_t kBlockMax = kBodyMax + 3U;
constexpr size_t kFrameMax = kBlockMax + 1U;

// CRC-16/IBM-3740: polynomial 1021h, initial FFFFh, nothing reflected, no final XOR.
uint16_t crc16(const uint8_t* data, size_t length);

// Stuffs up to 253 bytes into `out`, which must hold one more, and returns the number of bytes, none of them zero.
size_t stuff(const uint8_t* data, size_t length, uint8_t* out);

// Removes the stuffing of a block in place and returns its length, or 0 if a run exceeds the block.
size_t unstuff(uint8_t* block, size_t length);

// Frames a body of up to kBodyMax bytes and returns the number of bytes written, up to kFrameMax.
size_t frame(const uint8_t* body, size_t length, uint8_t* out);

// Splitter of a byte stream into the bodies of valid frames. An invalid block is dropped up to the next zero byte; of a
// block that is too long only kBlockMax bytes are stored.
class Deframer {
 public:
  // Accepts a byte and returns the length of the body that it completes, else 0. `body` is valid until the next byte.
  size_t take(uint8_t byte);

  const uint8_t* body() const { return block_; }

 private:
  uint8_t block_[kBlockMax] = {};
  size_t length_ = 0U;
  // Too many bytes arrived without a zero.
  bool lost_ = false;
};

}  // namespace softarm
