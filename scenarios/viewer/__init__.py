"""rerun recordings and how they are laid out."""
