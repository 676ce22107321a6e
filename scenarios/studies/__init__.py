"""Studies that measure surefoot itself."""
