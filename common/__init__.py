"""What has no robot in it, for every room above; and the one law of braking."""
