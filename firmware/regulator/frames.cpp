#include "frames.h"

namespace softarm {

namespace {

constexpr size_t kCheckBytes = 2U;

}  // namespace

uint16_t crc16(const uint8_t* data, size_t length) {
  uint32_t crc = 0xFFFFU;
  for (size_t i = 0U; i < length; ++i) {
    crc ^= static_cast<uint32_t>(data[i]) << 8U;
    for (uint8_t bit = 0U; bit < 8U; ++bit) {
      crc <<= 1U;
      if ((crc & 0x10000U) != 0U) {
        crc ^= 0x11021U;
      }
    }
  }
  return static_cast<uint16_t>(crc);
}

size_t stuff(const uint8_t* data, size_t length, uint8_t* out) {
  // Position of the present run's length.
  size_t code = 0U;
  size_t to = 1U;
  for (size_t i = 0U; i < length; ++i) {
    if (data[i] == 0U) {
      out[code] = static_cast<uint8_t>(to - code);
      code = to;
    } else {
      out[to] = data[i];
    }
    ++to;
  }
  out[code] = static_cast<uint8_t>(to - code);
  return to;
}

size_t unstuff(uint8_t* block, size_t length) {
  size_t from = 0U;
  size_t to = 0U;
  while (from < length) {
    const size_t end = from + block[from];
    if (end > length) {
      return 0U;
    }
    for (++from; from < end; ++from) {
      block[to] = block[from];
      ++to;
    }
    if (end < length) {
      block[to] = 0U;
      ++to;
    }
  }
  return to;
}

size_t frame(const uint8_t* body, size_t length, uint8_t* out) {
  uint8_t content[kBodyMax + kCheckBytes];
  for (size_t i = 0U; i < length; ++i) {
    content[i] = body[i];
  }
  const uint16_t check = crc16(body, length);
  content[length] = static_cast<uint8_t>(check & 0xFFU);
  content[length + 1U] = static_cast<uint8_t>(check >> 8U);
  const size_t stuffed = stuff(content, length + kCheckBytes, out);
  out[stuffed] = 0U;
  return stuffed + 1U;
}

size_t Deframer::take(uint8_t byte) {
  if (byte != 0U) {
    if (length_ < kBlockMax) {
      block_[length_] = byte;
      ++length_;
    } else {
      lost_ = true;
    }
    return 0U;
  }
  const size_t content = lost_ ? 0U : unstuff(block_, length_);
  length_ = 0U;
  lost_ = false;
  if (content <= kCheckBytes) {
    return 0U;
  }
  const size_t length = content - kCheckBytes;
  const uint32_t check = static_cast<uint32_t>(block_[length]) | (static_cast<uint32_t>(block_[length + 1U]) << 8U);
  return (check == crc16(block_, length)) ? length : 0U;
}

}  // namespace softarm
