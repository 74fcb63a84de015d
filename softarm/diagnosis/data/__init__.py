"""Recordings in: logs, trial folders, tables of other rigs, each as trials with their own stamps."""
