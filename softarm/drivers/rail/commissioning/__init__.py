"""Commissioning of the rail without the daemon: homing the drive and finding the middle of the rail."""

UNTRIED = "Homing and centring of the rail were tested with an emulated dryve D1 only, never on a real axis."
