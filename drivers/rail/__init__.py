"""The rail's drive, a dryve D1 on Modbus TCP."""
