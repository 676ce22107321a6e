"""`python -m surefoot` is the command line."""

from surefoot.scenarios.cli.start import entry_point

if __name__ == "__main__":
    entry_point()
