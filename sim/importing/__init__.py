"""A recording from elsewhere becomes a Log, by an import map."""
