"""Policy network, learner, inference and validation."""
