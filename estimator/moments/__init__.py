"""Quadrature of a Gaussian's moments on a box."""
