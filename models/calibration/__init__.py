"""Bounds on an observer's errors, where they hold, and what lasts of the errors."""
