"""What stands between this computer and a flying arm: facts are gathered, then judged. Nothing is moved."""
