"""Check of exported logs in Foxglove Studio, in its last open version from npm."""
