"""Joints of any mechanism with a MuJoCo model; each joint is one stage, driven by the measured motion around it."""
