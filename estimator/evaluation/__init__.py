"""Trajectories, and how consistent an estimate is."""
