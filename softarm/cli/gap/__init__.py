"""Verbs that measure, explain and close the gap between robot and simulator."""
