"""MCAP recordings: writing during a flight, reading however the file ends, finishing and listing."""
