"""Verbs that train, plan, compare and create policies."""
