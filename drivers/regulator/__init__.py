"""The pressure regulator behind a Teensy on a serial line."""
