"""Single stages of other rigs as views: what follows a command, what swings."""
