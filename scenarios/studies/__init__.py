"""Studies of surefoot itself."""
