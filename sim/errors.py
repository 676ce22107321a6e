"""The one error that a user is meant to read."""


class SurefootError(ValueError):
    """Bad input, said in one line that names the file, column or option at fault."""
