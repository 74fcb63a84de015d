"""Assembly of the answer from the engine's results, the same for the robot and for rigs."""
