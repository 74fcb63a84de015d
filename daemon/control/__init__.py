"""What the tick is made of: observer, checks, failsafe, safety filter, goals. Pure."""
