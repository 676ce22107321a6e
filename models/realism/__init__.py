"""How a legged robot's log looks as a walk: gait, standing feet, forces and vibration."""
