"""`softarm rail`: home the axis and find the middle of the rail."""
