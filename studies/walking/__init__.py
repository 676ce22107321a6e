"""How robots walk."""
