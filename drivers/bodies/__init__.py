"""Robots without wires, the simulator's and the independent one, and the devices of either in this process."""
