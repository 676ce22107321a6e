"""Traces of measured logs, their reports, and the simulation of the effects found."""
