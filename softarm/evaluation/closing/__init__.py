"""Steps of `softarm close-gap` after the diagnosis, and the files that they write."""
