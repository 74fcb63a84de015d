"""Hold a series of pressures without a daemon, to compare the board with a gauge (docs/hardware/firmware.md)."""

import asyncio
import time

from softarm.drivers.regulator.driver import TeensyRegulator
from softarm.schemas.config import SerialRegulator

PORT = "/dev/serial/by-id/usb-Teensyduino_USB_Serial-if00"
SECONDS = 10.0

board = TeensyRegulator(SerialRegulator(port=PORT))
board.start()
for armed, kpa in ((False, 0.0), (True, 0.0), (True, 5.0), (True, 10.0), (True, 15.0), (True, 20.0), (True, -0.7)):
    until = time.monotonic() + SECONDS
    while time.monotonic() < until:
        board.write(armed, kpa)
        time.sleep(1 / 30)
    reading = board.read()
    said = "no answer" if reading is None else f"{reading.pressure_kpa:6.2f} kPa, armed: {reading.armed}"
    print(f"asked for {kpa:5.1f} kPa: {said} {board.problem() or ''}")
asyncio.run(board.stop())
