"""Motion capture over Zenoh."""
