"""Which effect does the model lack? Evidence, fit, noise floor, selection, search."""
