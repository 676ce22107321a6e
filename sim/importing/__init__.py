"""Somebody's recording becomes a Log, as a map says."""
