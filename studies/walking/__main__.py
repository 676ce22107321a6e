"""`python -m studies.walking`: how the robots walk."""

from studies.command import run_study
from studies.walking.study import WalkingStudy

if __name__ == "__main__":
    run_study(WalkingStudy)
