"""Side-by-side measurements against peers, from a checkout: `python -m softarm.benchmarks.NAME --help` says what it is.

Never part of the tests, and not installed. With --json a measurement keeps its figures and where they come from.
"""
