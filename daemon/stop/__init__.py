"""Ways to an emergency stop that share nothing with the API (a socket with a thread of its own, a key), and its latch
on the disk.
"""
