// Program of the regulator board: a Teensy 3.6 between the daemon's serial line and the valve. The rules are in core.cpp,
// the circuit in board.h, and the commissioning in docs/hardware/firmware.md.
#include <Arduino.h>

#include "board.h"
#include "core.h"
#include "teensy36.h"

namespace {

// After so many bytes the outputs are updated, even if more bytes wait.
constexpr uint8_t kBytesAtOnce = 64U;

softarm::Core core(softarm::draw_token);

softarm::Reading read_sensor() {
  return softarm::reading_of(softarm::kSensor, static_cast<uint16_t>(analogRead(A0)));
}

void update_outputs() {
  digitalWrite(softarm::kRelayPin, core.relay_closed() ? HIGH : LOW);
  analogWrite(A21, softarm::output_counts(softarm::kValve, softarm::kAmplifier, core.armed(), core.set_point_kpa()));
  digitalWrite(softarm::kLedPin, core.armed() ? HIGH : LOW);
}

// A host that does not read loses answers: waiting for it would delay the check of the time to live.
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
  // A21 is the first DAC.
  analogWriteResolution(12);
  analogReadResolution(12);
  analogReadAveraging(8);
  update_outputs();
  Serial.begin(115200);
  softarm::start_watchdog(softarm::kWatchdogMs);
}

void loop() {
  const softarm::Reading sensor = read_sensor();
  core.watch(micros());
  update_outputs();
  for (uint8_t i = 0U; (i < kBytesAtOnce) && (Serial.available() > 0); ++i) {
    uint8_t answer[softarm::kFrameMax];
    const size_t length = core.take(static_cast<uint8_t>(Serial.read()), micros(), sensor, answer);
    if (length > 0U) {
      update_outputs();
      send(answer, length);
    }
  }
  softarm::feed_watchdog();
}
