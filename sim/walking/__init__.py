"""Built on walks: batches, an environment, imitations of a measured walk, a radar."""
