"""Independent robot behind the three interfaces of docs/reference/wires.md, with a body of its own.

It was written from that page and the robot's parameters only. It imports no module of softarm and shares no code with
it; no code may be copied here from a driver or the twin.
"""
