"""ROS 2 topics over Zenoh in the wire format of rmw_zenoh, without ROS; independent of the control loop."""
