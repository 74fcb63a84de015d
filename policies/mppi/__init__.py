"""Replanning in real time: thousands of simulated plans a second, the best one's first command flown."""
