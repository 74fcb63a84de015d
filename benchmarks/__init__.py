"""Speed and accuracy, also next to other programs: `python -m benchmarks.NAME --help` describes each benchmark.

Not installed and not run by the tests. With --json a benchmark stores its figures and how they were measured.
"""
