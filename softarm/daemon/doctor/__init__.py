"""Pre-flight checks of `softarm doctor`: gather facts, then judge them. Nothing moves."""
