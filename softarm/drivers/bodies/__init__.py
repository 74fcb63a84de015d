"""Robots without wires (the simulator's and the independent one) and their devices inside this process."""
