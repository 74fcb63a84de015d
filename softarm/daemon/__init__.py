"""The daemon: control loop, API, logbook, dashboard and health checks."""
