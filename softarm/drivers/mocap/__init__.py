"""Motion capture: frames over Zenoh, or from an installed plug-in."""
