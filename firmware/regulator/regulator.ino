// The regulator board's program: a Teensy 3.6 between the daemon's serial line and the valve. What it obeys is in
// core.cpp, what is at its pins in board.h, how it is brought into service in docs/firmware.md.
#include <Arduino.h>

#include "board.h"
#include "core.h"
#include "teensy36.h"

namespace {

constexpr uint8_t kBytesAtOnce = 64U;  // then the outputs are looked after, whatever else waits on the line

softarm::Core core(softarm::draw_token);

softarm::Reading read_sensor() {
  return softarm::reading_of(softarm::kSensor, static_cast<uint16_t>(analogRead(A0)));
}

void put_out() {
  digitalWrite(softarm::kRelayPin, core.relay_closed() ? HIGH : LOW);
  analogWrite(A21, softarm::output_counts(softarm::kValve, softarm::kAmplifier, core.armed(), core.set_point_kpa()));
  digitalWrite(softarm::kLedPin, core.armed() ? HIGH : LOW);
}

// A host that does not read loses answers: to wait for it would keep the time to live from being looked at.
void send(const uint8_t* answer, size_t length) {
  if (Serial.availableForWrite() >= static_cast<int>(length)) {
    Serial.write(answer, length);
    Serial.send_now();
  }
}

}  // namespace

void setup() {
  digitalWrite(softarm::kRelayPin, LOW);
  pinMode(softarm::kRelayPin, OUTPUT);
  pinMode(softarm::kLedPin, OUTPUT);
  analogWriteResolution(12);  // A21 is the first DAC
  analogReadResolution(12);
  analogReadAveraging(8);
  put_out();
  Serial.begin(115200);
  softarm::start_watchdog(softarm::kWatchdogMs);
}

void loop() {
  const softarm::Reading sensor = read_sensor();
  core.watch(micros());
  put_out();
  for (uint8_t i = 0U; (i < kBytesAtOnce) && (Serial.available() > 0); ++i) {
    uint8_t answer[softarm::kFrameMax];
    const size_t length = core.take(static_cast<uint8_t>(Serial.read()), micros(), sensor, answer);
    if (length > 0U) {
      put_out();
      send(answer, length);
    }
  }
  softarm::feed_watchdog();
}
