"""Access control: who may command the robot, and the sockets on which the daemon listens."""
