"""What the robot's rail was seen to do, and what the configuration's limits make of it."""
