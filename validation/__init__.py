"""Evidence that the system keeps its promises, from a checkout: `python -m validation.NAME --help` describes each one.

Not installed. Each validation stores its figures, with the revision they were measured on, in benchmarks/results/.
"""
