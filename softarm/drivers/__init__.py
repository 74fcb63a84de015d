"""Motion capture, regulator and rail: the real devices, the in-process simulated robot and the twin."""
