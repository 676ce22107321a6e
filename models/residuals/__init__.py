"""What readings say beyond the model, channel by channel, and the Jacobians of it."""
