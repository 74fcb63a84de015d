"""Verbs that write, check and install a configuration."""
