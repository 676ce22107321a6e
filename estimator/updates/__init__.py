"""Measurement updates: velocity, coverage, contacts, and the bias of an observer as states."""
