"""Lie groups, navigation state and IMU propagation."""
