"""The tick in the world: the 30 Hz loop, the whole daemon, the lockstep without a clock, the replay of a log."""
