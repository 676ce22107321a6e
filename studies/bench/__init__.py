"""Run times, as ratios measured in one run."""
