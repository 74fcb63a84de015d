"""Control, simulation and training for a dynamic soft robot arm on a rail.

Each room of the house is a package here (`softarm.daemon`, `softarm.simulator`, ...). In a checkout the rooms lie at
the top level and this folder links to them; what is installed holds them as real folders.
"""

__version__ = "0.2.0"
