"""Simulation and logs: robots, terrain, gait, sensors, effects and the Log."""
