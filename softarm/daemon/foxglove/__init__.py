"""Live data for Foxglove, independent of the control loop."""
