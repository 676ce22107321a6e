"""Scenario files, experiments, reports, rerun recordings and the command line."""
