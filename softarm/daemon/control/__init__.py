"""Parts of the control tick: observer, checks, failsafe, safety filter, goals. Pure."""
