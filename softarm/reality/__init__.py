"""An independent robot in MuJoCo that checks the simulator and the diagnosis; it shares no code with either."""
