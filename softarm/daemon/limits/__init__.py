"""Limits of the rail measured from recordings, compared with the configured limits."""
