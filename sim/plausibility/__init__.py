"""Physical plausibility of a log: what its numbers cannot mean, stream by stream."""

from surefoot.sim.plausibility.finding import Finding
from surefoot.sim.plausibility.rules import RULES, check_log, rules_table

__all__ = ["RULES", "Finding", "check_log", "rules_table"]
