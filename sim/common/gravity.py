"""Gravity, for simulation, sensors and filters."""

import numpy as np

GRAVITY = 9.81
"""Magnitude [m/s^2]."""
GRAVITY_G = np.array([0.0, 0.0, -GRAVITY])
"""Gravity in G [m/s^2]; z of G points up."""
