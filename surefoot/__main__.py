"""`python -m surefoot` is the command line."""

from surefoot.scenarios.cli.start import main

if __name__ == "__main__":
    main()
