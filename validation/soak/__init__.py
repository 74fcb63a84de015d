"""Soak test: hours of flying, with checks for growth and for unexpected events."""
