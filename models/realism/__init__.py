"""Measures of how a legged robot walks: gait, standing feet, foot forces and vibration."""
