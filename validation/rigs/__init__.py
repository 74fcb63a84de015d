"""Test rigs with known faults: axes, servos, chambers, carts, pendulums and arms.

Their laws and integration share no code with the diagnosis: bristle friction, queues, orifices, jointed links. All
variants of a rig (with its faults, without them, with each one left out) and all its trials run in parallel lanes.
"""
