"""What a run leaves: the learning curve, pictures, a page, the exported policy."""
