"""Independent mechanisms in MuJoCo with actuator and friction laws of their own, for tests of the diagnosis."""
