// The firmware's core as a program of this computer, behind a pseudo-terminal for the daemon's driver. It prints the
// path of the terminal and every change of its outputs, until it is interrupted.
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

// Opens a pseudo-terminal and returns its own end, or -1. The other end stays open, because its close would end this one.
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

void print_changes(const softarm::Core& core) {
  static int printed = -1;
  static float printed_kpa = 0.0F;
  const int now = (core.armed() ? 1 : 0) | (core.relay_closed() ? 2 : 0);
  if (now != printed || core.set_point_kpa() < printed_kpa || core.set_point_kpa() > printed_kpa) {
    printed = now;
    printed_kpa = core.set_point_kpa();
    printf("%s, %.2f kPa, relay %s, faults %04X\n", core.armed() ? "armed" : "disarmed", static_cast<double>(printed_kpa),
           core.relay_closed() ? "closed" : "open", core.faults());
    (void)fflush(stdout);
  }
}

}  // namespace

int main() {
  const int line = open_line();
  if (line < 0) {
    perror("no pseudo-terminal available; check /dev/pts");
    return 1;
  }
  printf("drivers.regulator.port: %s\n", ptsname(line));
  softarm::Core core(draw_token);
  for (;;) {
    core.watch(now_us());
    print_changes(core);
    pollfd ready = {line, POLLIN, 0};
    (void)poll(&ready, 1U, kStepMs);
    uint8_t received[64];
    const ssize_t count = read(line, received, sizeof received);
    for (ssize_t i = 0; i < count; ++i) {
      uint8_t answer[softarm::kFrameMax];
      // Without a muscle the sensor reads the set-point.
      const softarm::Reading sensor = {core.set_point_kpa(), true};
      const size_t length = core.take(received[i], now_us(), sensor, answer);
      if (length > 0U && write(line, answer, length) < 0) {
        // A host that does not read loses answers.
      }
    }
  }
}
