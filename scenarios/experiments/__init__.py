"""Grids over scenarios, robots, conditions and filters: from a file to one tidy table."""
