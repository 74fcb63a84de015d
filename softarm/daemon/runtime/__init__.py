"""Runtimes of the tick: the 30 Hz loop, the lockstep with a simulated robot, the replay of a log."""
