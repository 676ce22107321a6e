"""The groups, the navigation state, and IMU propagation."""
