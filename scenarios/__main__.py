"""`python -m scenarios` is `surefoot`."""

from scenarios.cli import main

if __name__ == "__main__":
    main()
