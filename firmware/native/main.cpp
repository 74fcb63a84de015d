// The core as a program of this computer: a board without pins behind a pseudo-terminal, which the daemon's driver may
// open. It says on its standard output where that is, then every change of its outputs, until it is interrupted.
#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/random.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "../regulator/core.h"

namespace {

constexpr int kStepMs = 1;

uint32_t draw_token() {
  uint32_t token = 0U;
  if (getrandom(&token, sizeof token, 0U) != static_cast<ssize_t>(sizeof token)) {
    abort();
  }
  return token;
}

uint32_t now_us() {
  timespec now = {};
  (void)clock_gettime(CLOCK_MONOTONIC, &now);
  return static_cast<uint32_t>(now.tv_sec * 1000000 + now.tv_nsec / 1000);
}

// A pseudo-terminal's end for us; the other is kept open, or a host that goes away would end ours. -1: there is none.
int open_line() {
  const int line = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
  if (line < 0 || grantpt(line) != 0 || unlockpt(line) != 0) {
    return -1;
  }
  const int other = open(ptsname(line), O_RDWR | O_NOCTTY);
  termios raw = {};
  if (other < 0 || tcgetattr(other, &raw) != 0) {
    return -1;
  }
  cfmakeraw(&raw);
  return tcsetattr(other, TCSANOW, &raw) == 0 ? line : -1;
}

void tell(const softarm::Core& core) {
  static int told = -1;
  static float told_kpa = 0.0F;
  const int now = (core.armed() ? 1 : 0) | (core.relay_closed() ? 2 : 0);
  if (now != told || core.set_point_kpa() < told_kpa || core.set_point_kpa() > told_kpa) {
    told = now;
    told_kpa = core.set_point_kpa();
    printf("%s, %.2f kPa, relay %s, faults %04X\n", core.armed() ? "armed" : "disarmed", static_cast<double>(told_kpa),
           core.relay_closed() ? "closed" : "open", core.faults());
    (void)fflush(stdout);
  }
}

}  // namespace

int main() {
  const int line = open_line();
  if (line < 0) {
    perror("there is no pseudo-terminal to be had; see /dev/pts");
    return 1;
  }
  printf("drivers.regulator.port: %s\n", ptsname(line));
  softarm::Core core(draw_token);
  for (;;) {
    core.watch(now_us());
    tell(core);
    pollfd ready = {line, POLLIN, 0};
    (void)poll(&ready, 1U, kStepMs);
    uint8_t heard[64];
    const ssize_t count = read(line, heard, sizeof heard);
    for (ssize_t i = 0; i < count; ++i) {
      uint8_t answer[softarm::kFrameMax];
      // The sensor of a board without a muscle reads what was commanded.
      const softarm::Reading sensor = {core.set_point_kpa(), true};
      const size_t length = core.take(heard[i], now_us(), sensor, answer);
      if (length > 0U && write(line, answer, length) < 0) {
        // A host that does not read loses answers.
      }
    }
  }
}
