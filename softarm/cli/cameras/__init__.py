"""`softarm bridge`: feed motion capture to the daemon and calibrate it."""
