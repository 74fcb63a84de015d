"""The network and the learner."""
