"""`python -m studies.loads`: the study of loads tied to links, and of fixed bases."""

from studies.command import run_study
from studies.loads.study import LoadsStudy

if __name__ == "__main__":
    run_study(LoadsStudy)
