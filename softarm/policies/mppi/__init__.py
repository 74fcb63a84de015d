"""Replanning in real time: thousands of simulated plans per second, of which the best gives the command."""
