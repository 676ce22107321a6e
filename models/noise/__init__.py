"""Noise of sensors, from a log in which the robot rests."""
