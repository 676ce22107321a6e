"""`python -m studies.bench`: run times relative to peers."""

from studies.bench.run import Bench
from studies.command import run_study

if __name__ == "__main__":
    run_study(Bench)
