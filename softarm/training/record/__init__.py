"""Records of a training run: settings, checkpoints, learning curve, pictures, page and exported policy."""
