"""Gravity, as every world, sensor and filter has it."""

import numpy as np

GRAVITY = 9.81
"""Magnitude [m/s^2]; it points along -z of G."""
GRAVITY_G = np.array([0.0, 0.0, -GRAVITY])
"""Its vector in G [m/s^2]."""
