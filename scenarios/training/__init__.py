"""Walks to train observers on."""
