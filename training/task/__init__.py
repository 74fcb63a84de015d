"""What is to be learned, and the many robots it is learned on."""
