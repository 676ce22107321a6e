"""Filters on logs: the registry, their parameters, and comparisons."""
