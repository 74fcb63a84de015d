"""REST and WebSocket API of the daemon, independent of the control loop's timing."""
