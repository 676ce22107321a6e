"""What sensors read of a motion."""
