"""Engine of the diagnosis, the same for every view: fits, search, held-out scores, decision."""
