"""The pressure regulator behind a Teensy microcontroller."""

UNTRIED = "The serial driver and the firmware of the pressure regulator were never run on a Teensy with a valve."
