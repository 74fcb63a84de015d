"""Servos that BAM (Better Actuator Models) simulates, with friction that its authors identified on real ones."""
