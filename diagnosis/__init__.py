"""Where is the gap between robot and simulator: trials, system identification, diagnosis."""
