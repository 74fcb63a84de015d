"""The rail's drive, a dryve D1 on Modbus TCP."""

UNTRIED = "The TCP driver of the rail was tested with an emulated dryve D1 only, never with a real drive and axis."
