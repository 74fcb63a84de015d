"""Flying for hours: do memory, descriptors, threads, logs, lateness stay as they are, and does nothing else happen?"""
