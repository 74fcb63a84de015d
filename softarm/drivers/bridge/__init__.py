"""Bridge from another motion capture system's stream to the daemon's frames."""

UNTRIED = (
    "The motion capture bridge was tested with an emulated NatNet server only, never with OptiTrack cameras and Motive."
)
