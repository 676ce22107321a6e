"""`python -m studies.hardware`: the studies of real machines."""

from studies.command import run_study
from studies.hardware.study import HardwareStudy

if __name__ == "__main__":
    run_study(HardwareStudy)
