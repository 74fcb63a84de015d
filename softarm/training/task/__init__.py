"""Tasks and the batch environment in which they are learned."""
