"""Bridges: what other people's motion capture streams, as the daemon's frames."""
