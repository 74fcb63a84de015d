"""Evidence that the system keeps its promises, from a checkout: `python -m validation.NAME --help` describes each one.

Not installed: jobs on a Ray cluster need the checkout on every node. Figures on the pages are stored in
benchmarks/results/, with the revision they were measured on; the benchmarks of rigs and mechanisms only print theirs.
"""
