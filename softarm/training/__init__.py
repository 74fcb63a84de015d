"""Tasks, the batch environment, PPO, evaluation and export of learned policies."""

import os

# OpenMP's threads, which step the robots, otherwise spin for milliseconds after each batch, on the cores that the
# learner's threads want by then. Read once, when torch is loaded, so it has to be said before.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
