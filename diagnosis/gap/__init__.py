"""The gap between a recording and a simulator: where it is, which effect causes it, how far it shrinks."""
