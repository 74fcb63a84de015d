"""System identification of the arm."""
