"""Three studies of real hardware."""
