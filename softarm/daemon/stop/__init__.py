"""Emergency stop: the dedicated stop port, the stop key of the terminal, and the latch kept on disk."""
