"""Import of recordings from elsewhere as Logs, by an import map."""
