"""Trajectory optimisation: command sequences that swing the tip onto a target ([P] SM-H)."""
