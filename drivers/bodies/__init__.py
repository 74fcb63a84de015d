"""Robots in this process, in lockstep with whoever reads them: the simulator's and the independent one."""
