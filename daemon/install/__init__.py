"""The daemon as a service of this computer: what has to be where, and putting it there."""
