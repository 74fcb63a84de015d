"""Fuzzing: every parser must reject invalid input with a message."""
