"""Other people's rigs: axes, servos, chambers, carts, pendulums and arms whose faults are known to us alone.

Own laws, own integration, as in the rest of this room: friction of bristles, queues, orifices, bodies in joints. All
variants of a rig (with its faults, without, with each alone left out) and all its trials run side by side, a lane each.
"""
