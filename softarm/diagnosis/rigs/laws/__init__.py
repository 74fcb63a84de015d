"""The laws of the rigs, compiled: how a stage would have moved for given parameters."""
