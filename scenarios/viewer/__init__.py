"""rerun recordings and their layout."""
