"""Trajectories, and tests of an estimate's consistency."""
