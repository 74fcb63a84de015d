"""A robot from outside: the three wires of docs/wires.md and a body of its own, written from that page and the robot's
numbers alone. It shares no line with softarm and imports none; nothing here may be borrowed from a driver or the twin.
"""
