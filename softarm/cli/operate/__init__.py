"""Verbs that run the daemon and ask it to move the arm."""
