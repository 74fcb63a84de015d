"""Training runs: sessions, recipes, sweeps, and retraining of a policy."""
