"""The fault matrix: everything that can be made to go wrong, made to go wrong, one thing at a time.

    python -m softarm.benchmarks.matrix --json FILE

Daemon, rail link and twin are the processes that a person starts; between daemon and twin stand wires that can be bad
(`wires.py`). What a fault led to is read off the robot's own truth, the API and the log (`flight.py`), and judged
(`cells.py`).
"""
