"""Studies of real hardware."""
