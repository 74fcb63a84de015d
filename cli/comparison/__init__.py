"""What `softarm evaluate --all` measures and shows: trials, the robots they are flown on, the table, its page."""
