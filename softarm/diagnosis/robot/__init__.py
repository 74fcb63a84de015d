"""Our robot: its stages as views, what is read off stamps, the chain to the tip, what to fly next."""
