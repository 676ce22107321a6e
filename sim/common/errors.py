"""The one error that a user is meant to read, and the check that every seed passes."""


class SurefootError(ValueError):
    """Bad input, said in one line that names the file, column or option at fault."""


def check_seed(seed: int) -> None:
    """Raise SurefootError for a seed that no generator takes."""
    if seed < 0:
        raise SurefootError(f"--seed {seed}: must not be negative")
    if seed > 2**53:
        raise SurefootError("--seed: must not be beyond 2^53")
