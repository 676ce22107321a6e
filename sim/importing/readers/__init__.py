"""Files of a recording, of any kind, as tables of raw cells."""
