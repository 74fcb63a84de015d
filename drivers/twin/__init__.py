"""The twin: the robot as its wires see it, in a process of its own. docs/wires.md says what it assumes."""
