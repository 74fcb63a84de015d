"""A log of ours in Foxglove Studio, whose last open version npm has."""
