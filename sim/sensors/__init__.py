"""Sensors of a simulated robot."""
