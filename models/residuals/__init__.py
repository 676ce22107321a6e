"""Residuals of readings against the model, channel by channel, and their Jacobians."""
