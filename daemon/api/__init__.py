"""REST and WebSocket: a guest of the control loop."""
