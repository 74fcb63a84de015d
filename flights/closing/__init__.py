"""The steps of `softarm close-gap` after the diagnosis, and what they leave behind."""
