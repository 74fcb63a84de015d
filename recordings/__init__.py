"""Recordings as files: whole MCAP records and the devices' channels, for whoever reads or writes a log."""
