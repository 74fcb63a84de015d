"""An independent robot in MuJoCo, for checking what the simulator and the diagnosis say. Shares no line with either."""
