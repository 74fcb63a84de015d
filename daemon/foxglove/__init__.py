"""Live to Foxglove: a guest that nobody waits for."""
