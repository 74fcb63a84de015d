// A Teensy's pins and serial line as variables, which the sketch sets and the tests read.
#include "teensyduino/Arduino.h"

#include <string.h>

#include "../../firmware/regulator/teensy36.h"

namespace {

constexpr size_t kLineMax = 4096U;

struct Pin {
  int mode = -1;
  int value = -1;
  // Value at the time when the pin became an output.
  int value_as_output = -1;
};

Pin pins[128];
uint32_t now = 0U;
int sensor_counts = 0;
uint32_t write_bits = 8U, read_bits = 10U;
uint8_t incoming[kLineMax], outgoing[kLineMax];
size_t incoming_length = 0U, incoming_taken = 0U, outgoing_length = 0U;
int room = 64;
uint32_t watchdog_ms = 0U, fed = 0U, tokens = 0U;

}  // namespace

volatile uint16_t WDOG_UNLOCK, WDOG_TOVALH, WDOG_TOVALL, WDOG_PRESC, WDOG_STCTRLH, WDOG_REFRESH;
volatile uint32_t SIM_SCGC6;
usb_serial_class Serial;

void pinMode(uint8_t pin, uint8_t mode) {
  pins[pin].mode = mode;
  pins[pin].value_as_output = pins[pin].value;
}
void digitalWrite(uint8_t pin, uint8_t value) { pins[pin].value = value; }
void analogWrite(uint8_t pin, int value) { pins[pin].value = write_bits == 12U ? value : -1; }
uint32_t analogWriteResolution(uint32_t bits) { return write_bits = bits; }
int analogRead(uint8_t pin) { return pin == A0 && read_bits == 12U ? sensor_counts : -1; }
void analogReadResolution(unsigned int bits) { read_bits = bits; }
void analogReadAveraging(unsigned int) {}
uint32_t micros(void) { return now; }
void delayMicroseconds(uint32_t microseconds) { now += microseconds; }
void noInterrupts() {}
void interrupts() {}

void usb_serial_class::begin(long) {}
int usb_serial_class::available() { return static_cast<int>(incoming_length - incoming_taken); }
int usb_serial_class::read() {
  if (incoming_taken == incoming_length) {
    return -1;
  }
  const uint8_t byte = incoming[incoming_taken];
  ++incoming_taken;
  return byte;
}
int usb_serial_class::availableForWrite() { return room; }
size_t usb_serial_class::write(const uint8_t* buffer, size_t size) {
  if (outgoing_length + size <= kLineMax) {
    (void)memcpy(outgoing + outgoing_length, buffer, size);
    outgoing_length += size;
  }
  return size;
}
void usb_serial_class::send_now() {}

namespace softarm {

void start_watchdog(uint32_t milliseconds) { watchdog_ms = milliseconds; }
void feed_watchdog() { ++fed; }
uint32_t draw_token() { return ++tokens; }

}  // namespace softarm

void setup();
void loop();

extern "C" {

void sketch_setup() { setup(); }
void sketch_loop() { loop(); }

int pin_mode(uint8_t pin) { return pins[pin].mode; }
int pin_value(uint8_t pin) { return pins[pin].value; }
int pin_value_as_output(uint8_t pin) { return pins[pin].value_as_output; }
void clock_set(uint32_t now_us) { now = now_us; }
void sensor_set(int counts) { sensor_counts = counts; }
void line_room(int bytes) { room = bytes; }
uint32_t watchdog_time_ms() { return watchdog_ms; }
uint32_t watchdog_fed() { return fed; }

void line_say(const uint8_t* data, size_t length) {
  (void)memcpy(incoming, data, length < kLineMax ? length : kLineMax);
  incoming_length = length < kLineMax ? length : kLineMax;
  incoming_taken = 0U;
}

size_t line_waiting() { return incoming_length - incoming_taken; }

size_t line_hear(uint8_t* data) {
  const size_t length = outgoing_length;
  (void)memcpy(data, outgoing, length);
  outgoing_length = 0U;
  return length;
}
}
