"""Records of a training run: settings, checkpoints, learning curve, pictures and exported policy."""
