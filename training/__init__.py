"""Tasks, the batch environment, PPO, evaluation and export of learned policies."""
