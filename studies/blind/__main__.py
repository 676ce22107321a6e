"""`python -m studies.blind`: the blind study of `trace`."""

from studies.blind.study import BlindStudy
from studies.command import run_study

if __name__ == "__main__":
    run_study(BlindStudy)
