"""Verbs that read recordings and events."""
