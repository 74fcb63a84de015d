// What the sketch uses of Teensyduino for a Teensy 3.6, declared and not defined: enough to compile it on this computer, so
// that a slip of the pen cannot land. The names and types are those of its core library's headers (teensy3/ of version 1.5x).
#pragma once

#include <stddef.h>
#include <stdint.h>

#define HIGH 1
#define LOW 0
#define INPUT 0
#define OUTPUT 1
#define A0 14
#define A21 66  // DAC0

extern "C" {
void pinMode(uint8_t pin, uint8_t mode);
void digitalWrite(uint8_t pin, uint8_t value);
void analogWrite(uint8_t pin, int value);
uint32_t analogWriteResolution(uint32_t bits);
int analogRead(uint8_t pin);
void analogReadResolution(unsigned int bits);
void analogReadAveraging(unsigned int count);
uint32_t micros(void);
void delayMicroseconds(uint32_t microseconds);
}

void noInterrupts();
void interrupts();

class usb_serial_class {
 public:
  void begin(long baud);
  virtual int available();
  virtual int read();
  virtual int availableForWrite();
  virtual size_t write(const uint8_t* buffer, size_t size);
  void send_now();
};
extern usb_serial_class Serial;

// kinetis.h
extern volatile uint16_t WDOG_UNLOCK, WDOG_TOVALH, WDOG_TOVALL, WDOG_PRESC, WDOG_STCTRLH, WDOG_REFRESH;
extern volatile uint32_t SIM_SCGC6;
#define WDOG_UNLOCK_SEQ1 ((uint16_t)0xC520)
#define WDOG_UNLOCK_SEQ2 ((uint16_t)0xD928)
#define WDOG_STCTRLH_WDOGEN ((uint16_t)0x0001)
#define WDOG_STCTRLH_STOPEN ((uint16_t)0x0040)
#define WDOG_STCTRLH_WAITEN ((uint16_t)0x0080)
