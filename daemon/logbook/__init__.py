"""What a flight leaves behind: ticks and frames as channels of a log, written and read back."""
