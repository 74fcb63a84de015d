"""The twin: a simulated robot behind the real interfaces, for the daemon that runs on the real robot."""
