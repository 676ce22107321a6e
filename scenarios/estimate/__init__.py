"""Filters on logs: registry, parameters and comparisons."""
