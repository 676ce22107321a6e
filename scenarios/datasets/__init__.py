"""Datasets of simulated walks."""
