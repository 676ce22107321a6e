"""The quadratures behind a Gaussian's moments on a box."""
