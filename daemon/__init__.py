"""The control loop and its guests."""
