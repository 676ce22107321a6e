"""`python -m studies.montecarlo`: the paper's Monte-Carlo tables, with further regimes."""

from studies.command import run_study
from studies.montecarlo.report import MonteCarlo

if __name__ == "__main__":
    run_study(MonteCarlo)
