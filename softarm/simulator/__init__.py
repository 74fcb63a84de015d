"""The robot as a model: parameters, effects and the batch kernel that moves thousands of robots at once."""
