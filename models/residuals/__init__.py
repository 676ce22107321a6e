"""Residuals of a log's readings against the model, channel by channel, and their Jacobians."""
