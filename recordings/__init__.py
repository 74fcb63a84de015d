"""Recordings as files: MCAP written while it is flown, read however it ends, finished and listed."""
