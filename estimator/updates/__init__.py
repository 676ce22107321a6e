"""Measurement updates: velocity, coverage, contacts, and the persistent error of an observer."""
