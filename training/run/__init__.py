"""A training run, many of them, and one that goes on from a shipped policy."""
