"""`surefoot plan`: the motion that reveals each effect, its duration, and which other effect masks
it.

The robot walks short motions in simulation, from which the derivatives of the residual with respect
to every candidate effect are taken. With Gaussian noise of the size of the residuals and Gaussian
priors (`Effect.size_prior`), the covariance of all sizes together is
(f X^T W X + P)^-1, where f is the number of repetitions of the motion. A motion reveals an effect
if the standard deviation of its size is a tenth of what its prior allows.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from surefoot.models.attribution.design import design
from surefoot.models.attribution.evidence import Evidence, Key, all_keys, linearise, log_under_model
from surefoot.scenarios.reporting.tables import to_markdown
from surefoot.sim.common.errors import check_known
from surefoot.sim.effects import known_effects
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk

SHOWN = 0.1
"""Largest standard deviation of a size that counts as revealed, as a share of the prior's 95 %
size.
"""
LONGEST_S = 600.0
"""Longest duration of a planned motion [s]."""
SECONDS = 4.0
"""Duration of a simulated motion, from which longer ones are extrapolated [s]."""


@dataclass(frozen=True)
class Shown:
    """How well a motion reveals one effect.

    Attributes:
        seconds: duration of the motion until the effect is revealed; infinite if beyond LONGEST_S.
        deviation: standard deviation of its size after LONGEST_S, as a share of the prior's 95 %
            size.
        rival: the effect whose size is most correlated with it then; None below 0.5.
    """

    seconds: float
    deviation: float
    rival: Key | None


def motions(robot: Robot) -> dict[str, tuple[Segment, ...]]:
    """Motions to choose from, at the pace of the robot's legs."""
    v, t = 0.6 * np.sqrt(robot.leg_length / 0.66), SECONDS
    return {
        "stand": (Segment(t),),
        "walk straight": (Segment(t, v),),
        "walk in circles, both ways": (Segment(t / 2, v, turn=0.5), Segment(t / 2, v, turn=-0.5)),
        "walk sideways, both ways": (Segment(t / 2, 0.0, v / 3), Segment(t / 2, 0.0, -v / 3)),
        "start and stop": tuple(Segment(t / 4, s * v) for s in (1.4, 0.2, 1.4, 0.2)),
    }


def plan_motions(
    robot: Robot, effects: Sequence[str], progress: Callable[[float], None] = lambda share: None
) -> dict[Key, dict[str, Shown]]:
    """For each target of the effects, how well each motion reveals it.

    Raises SurefootError for an unknown effect.
    """
    known = known_effects()
    for name in effects:
        check_known("effect", name, known)
    found: dict[Key, dict[str, Shown]] = {}
    tried = motions(robot)
    for k, (motion, segments) in enumerate(tried.items()):
        log = walk(Scenario("plan", segments, Ground(0.8)), robot, seed=0)
        case = log_under_model(log, robot)
        # A target that is a group of others adds no information.
        groups = {name: one.group_targets(robot.limbs) for name, one in known.items()}
        keys = [key for key in all_keys(case) if key[1] not in groups[key[0]]]
        information, prior = _information(linearise([case], (), keys), keys)
        for i, key in enumerate(keys):
            if key[0] in effects:
                found.setdefault(key, {})[motion] = _shown(information, prior, i, keys)
        progress((k + 1) / len(tried))
    return found


def _information(evidence: Evidence, keys: Sequence[Key]) -> tuple[np.ndarray, np.ndarray]:
    """X^T W X (P, P) of candidates and nuisance parameters, and the diagonal (P,) of their prior
    precision.
    """
    columns = design(evidence)
    total = np.zeros((columns.size, columns.size))
    for y, rows, X, which in zip(columns.y.T, columns.rows, columns.X, columns.which, strict=True):
        if len(rows) and len(which):
            sigma = 1.4826 * np.median(np.abs(y[rows] - np.median(y[rows])))
            if sigma > 0.0:
                total[np.ix_(which, which)] += X.T @ X / sigma**2
    within = [known_effects()[name].size_prior().within / 1.96 for name, _ in keys]
    return total, np.concatenate([np.array(within), evidence.deviations]) ** -2.0


def _shown(information: np.ndarray, prior: np.ndarray, i: int, keys: Sequence[Key]) -> Shown:
    def covariance(seconds: float) -> np.ndarray:
        return np.linalg.inv(seconds / SECONDS * information + np.diag(prior))

    allowed = 1.96 * prior[i] ** -0.5
    after = covariance(LONGEST_S)
    deviations = np.sqrt(np.diag(after))
    correlations = after[i, : len(keys)] / (deviations[i] * deviations[: len(keys)])
    correlations[i] = 0.0
    rival = int(np.argmax(np.abs(correlations)))
    share, low, high = float(deviations[i] / allowed), 0.0, LONGEST_S
    # By halves, since the information of no time at all has no inverse.
    for _ in range(20):
        middle = 0.5 * (low + high)
        enough = np.sqrt(covariance(middle)[i, i]) <= SHOWN * allowed
        low, high = (low, middle) if enough else (middle, high)
    seconds = high if share <= SHOWN else np.inf
    return Shown(seconds, share, keys[rival] if abs(correlations[rival]) > 0.5 else None)


def motion_table(found: dict[Key, dict[str, Shown]]) -> list[dict[str, object]]:
    """One row per effect: its hardest target, the motion that reveals it soonest, and its rival."""
    hardest: dict[str, tuple[Key, str, Shown]] = {}
    for key, by_motion in found.items():
        motion, best = _soonest(by_motion)
        held = hardest.get(key[0])
        if held is None or (best.seconds, best.deviation) > (held[2].seconds, held[2].deviation):
            hardest[key[0]] = (key, motion, best)
    return [
        {
            "effect": name,
            "hardest to show": key[1],
            "motion": motion if np.isfinite(best.seconds) else "none of these",
            "seconds": max(1.0, best.seconds) if np.isfinite(best.seconds) else None,
            "deviation after 10 min [%]": 100.0 * best.deviation,
            "hidden by": f"{best.rival[0]} {best.rival[1]}" if best.rival else "",
        }
        for name, (key, motion, best) in hardest.items()
    ]


def recordings_to_make(found: dict[Key, dict[str, Shown]]) -> dict[str, float]:
    """Each motion that reveals some target soonest, and its duration [s] for all of these, at least
    one.
    """
    longest: dict[str, float] = {}
    for by_motion in found.values():
        motion, best = _soonest(by_motion)
        if np.isfinite(best.seconds):
            longest[motion] = max(longest.get(motion, 1.0), best.seconds)
    return longest


def _soonest(by_motion: dict[str, Shown]) -> tuple[str, Shown]:
    return min(by_motion.items(), key=lambda one: (one[1].seconds, one[1].deviation))


def plan_text(found: dict[Key, dict[str, Shown]]) -> str:
    """The table, the motions to record, and an explanation of the columns."""
    record = [f"{name}, {np.ceil(s):.0f} s" for name, s in recordings_to_make(found).items()]
    return (
        f"{to_markdown(motion_table(found))}\n\n"
        f"record at least: {'; '.join(record) or 'none of these motions reveals any of them'}\n\n"
        "hardest to show: the target of the effect that takes longest. seconds: duration [s] of "
        "the motion after which the standard deviation of the effect's size is a tenth of the size "
        "that 19 of 20 robots stay below, if all other effects are unknown too. deviation after 10 "
        "min: this standard deviation after ten minutes of the motion, in percent of that size. "
        "hidden by: the effect whose size has the most correlated error; empty if the correlation "
        "is below 0.5. These durations are from simulation with independent noise only: record "
        "several times as long."
    )
