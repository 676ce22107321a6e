"""Names of the items of `surefoot bench`; their functions, slow to import, are in `run`."""

from surefoot.sim.common.errors import SurefootError, did_you_mean

ITEMS = ("box", "coverage", "step", "gtsam", "montecarlo", "walking")


def check_item(name: str) -> None:
    """Raise SurefootError where there is no item of that name."""
    if name not in ITEMS:
        hint = did_you_mean(name, ITEMS)
        raise SurefootError(f"--only {name}: known are {', '.join(ITEMS)}{hint}")
