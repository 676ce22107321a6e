"""One search for the parameters of any filter: coordinates in turn, within a budget of runs.

A filter is judged on pieces of walks by the mean of

    log(APE_trans / path length) + PRICE |log(NEES_pos / 3)|,

so that it pays for being wrong and for not knowing it: NEES off 3 by the factor e costs as much as
an APE larger by the factor e^PRICE. Both are clipped: a diverged estimate is as bad as one whose
error is the path. The search is a compass search over the logarithms of the parameters (Kolda,
Lewis, Torczon, SIAM Review 2003): a step up or down each in turn, kept where it is better, and a
step half as long once none is.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from surefoot.estimator.evaluation.trajectory import Trajectory, reference
from surefoot.estimator.metrics import Metrics, evaluate
from surefoot.scenarios.estimate.registry import Learnt, estimated, estimator_named
from surefoot.scenarios.estimate.tuned import Parameters
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot

PRICE = 0.3
SHARES, NEES = (1e-5, 1.0), (0.01, 1000.0)
"""To which APE as a share of the path, and NEES, are clipped."""
STEP = 4.0
"""Factor of the first steps."""


@dataclass(frozen=True)
class Found:
    """What a search started from and what it ended with; runs are the values that were tried."""

    start: dict[str, float]
    start_price: float
    best: dict[str, float]
    price: float
    runs: int


Price = Callable[[Mapping[str, float]], float]


def search(price: Price, start: Mapping[str, float], budget: int) -> Found:
    """The lowest price within `budget` runs, `start` among them; all values are > 0."""
    if budget < 1:
        raise SurefootError(f"budget: {budget} where a whole number >= 1 is expected")
    best = first = dict(start)
    lowest = begun = price(first)
    tried, step = {_key(first)}, STEP
    while len(tried) < budget and step > 1.02:
        improved = False
        for name in start:
            for factor in (step, 1.0 / step):
                trial = best | {name: best[name] * factor}
                if _key(trial) in tried or len(tried) >= budget:
                    continue
                tried.add(_key(trial))
                if (found := price(trial)) < lowest:
                    best, lowest, improved = trial, found, True
                    break
        if not improved:
            step = np.sqrt(step)
    return Found(first, begun, {k: rounded(v) for k, v in best.items()}, lowest, len(tried))


def rounded(value: float) -> float:
    """To three digits: more were not found."""
    return float(f"{value:.3g}")


def _key(values: Mapping[str, float]) -> tuple[float, ...]:
    return tuple(round(float(np.log(value)), 6) for value in values.values())


@dataclass(frozen=True)
class Piece:
    """A filter made ready on a piece of a walk: only its parameters are still open."""

    name: str
    truth: Trajectory
    run: Callable[[Parameters], Trajectory]

    def judged(self, values: Parameters) -> Metrics:
        """Metrics with these parameters."""
        return evaluate(self.truth, self.run(values))


def piece(name: str, log: Log, robot: Robot, learnt: Learnt) -> Piece:
    """Raises SurefootError where the log lacks what a metric takes."""
    estimator = estimator_named(name)
    return Piece(
        log.name, reference(log), lambda values: estimated(estimator, log, robot, learnt, values)
    )


def price_of(metrics: Metrics) -> float:
    """The price of one estimate, lower is better; that of a diverged one is finite too."""
    share, nees = metrics.ape_trans / metrics.length, metrics.nees_position
    share = np.clip(share, *SHARES) if np.isfinite(share) else SHARES[1]
    nees = np.clip(nees, *NEES) if np.isfinite(nees) else NEES[1]
    return float(np.log(share) + PRICE * abs(np.log(nees / 3.0)))


def price_on(pieces: Sequence[Piece], values: Parameters) -> float:
    """The mean price over pieces; of a piece that the filter cannot finish, the highest."""
    prices = []
    for one in pieces:
        try:
            prices.append(price_of(one.judged(values)))
        except SurefootError:
            prices.append(PRICE * np.log(NEES[1] / 3.0))
    return float(np.mean(prices))


def facts_on(pieces: Sequence[Piece], values: Parameters) -> dict[str, dict[str, float]]:
    """APE [m and % of the path] and NEES by piece, for the report."""
    table = {}
    for one in pieces:
        m = asdict(one.judged(values))
        table[one.name] = {
            "ape": m["ape_trans"],
            "percent": 100 * m["ape_trans"] / m["length"],
            **{f"nees_{k}": m[f"nees_{k}"] for k in ("position", "velocity", "attitude")},
        }
    return table
