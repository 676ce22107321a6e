"""Walks: many at once, as an environment, like a measured one, seen by a radar; and their truth."""
