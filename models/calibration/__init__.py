"""Bounds on an observer's errors, their validity, and the persistent part of the errors."""
