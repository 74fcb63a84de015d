"""Helpers that do not depend on the robot, and the braking law."""
