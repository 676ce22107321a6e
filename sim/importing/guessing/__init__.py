"""Draft of an import map, by the names and values of the columns of a recording."""
