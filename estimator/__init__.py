"""Recursive filters on SE_2(3), their measurement updates, and trajectory metrics."""
