"""Installation of the daemon as a systemd service."""

UNTRIED = "The systemd service was tested without a robot only, never on the computer of a real bench."
