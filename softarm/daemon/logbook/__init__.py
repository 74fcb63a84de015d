"""Logs of ticks and frames, the event history and incident files."""
