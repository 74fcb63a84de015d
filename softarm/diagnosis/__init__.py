"""Diagnosis of the gap between robot and simulator: trials, identification, search for effects, report."""
