"""Fault matrix: cause every possible fault, one at a time, and judge the outcome.

    python -m validation.matrix --json FILE

Daemon, rail process and twin run as a user starts them; the wires between daemon and twin can be disturbed
(`wires.py`). The outcome is read from the robot's true state, the API and the log (`flight.py`) and judged
(`cells.py`).
"""
