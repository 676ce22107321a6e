"""Physical plausibility of a log: checks of every stream against the others and the robot's
model.
"""

# ruff: noqa: F401
from surefoot.sim.plausibility.finding import Finding
from surefoot.sim.plausibility.rules import RULES, check_log, rules_table
