"""Joint encoder errors that no effect of the catalogue describes.

An encoder offset, an encoder scale and joint compliance change the measured angle by a constant,
linearly in the angle, and in proportion to the torque. Eccentric magnets, ripple and cross-talk
change it by a nonlinear function of the angle, alone or times the torque, which no effect of the
catalogue models. Over the small range that a leg moves through, such a curve looks much like a
line, so an effect found at a joint is checked against Legendre polynomials of the angle.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import Legendre
from scipy.ndimage import uniform_filter1d

from surefoot.models.attribution.evidence import (
    Evidence,
    LogUnderModel,
    joined_regressor,
    wrt_columns,
)
from surefoot.models.attribution.fit import design, fit, loss, normal_equations
from surefoot.models.attribution.search import Attribution
from surefoot.models.attribution.settings import DEFAULT, TraceSettings
from surefoot.models.attribution.split import FIT, SELECT, Split
from surefoot.models.bootstrap import block_bootstrap_counts
from surefoot.sim.log import Log

ANGLE_CHANNELS = ("leg_velocity", "foot_height", "base_wrench", "joint_torque")


@dataclass(frozen=True)
class AngleError:
    """A joint whose measured angle is off by a nonlinear function of the angle.

    Attributes:
        joint: name of the joint.
        channel: channel in which the error shows most.
        share: share of the curve in what it and the effects found at the joint explain together on
            unseen blocks.
    """

    joint: str
    channel: str
    share: float


def angle_errors(
    cases: Sequence[LogUnderModel], result: Attribution, split: Split, rng: np.random.Generator
) -> tuple[AngleError, ...]:
    """Joints with an effect whose unseen blocks are explained better by a curve of the angle; the
    curve that explains most comes first.
    """
    s, found = cases[0].settings, [f.effect for f in result.found]
    limbs = result.evidence.layout.limbs
    kind = {joint: limbs.kind(i) for i, joint in enumerate(limbs.joints)}
    at = [e.target for e in found if e.target in kind and "leg_velocity" in e.channels]
    if not at or cases[0].fixed:
        return ()
    keys = [(e.name, e.target) for e in found]
    joints = [joint for joint in kind if kind[joint] in {kind[one] for one in at}]
    evidence = _with_curves(cases, result, joints)
    robust, whole = result.robust_weights, design(evidence)
    sigma = result.floor.effective_noise(robust.sigma, robust.alike)
    data = normal_equations(whole, sigma, result.robust_weights.weight, split.part)
    seen, unseen = data.rows(data.part == FIT), data.rows(data.part == SELECT)
    plain = fit(seen, keys, errors=False).vector
    bent = {j: fit(seen, [*keys, *_curves_of(evidence, j)], errors=False).vector for j in joints}
    gains = {joint: loss(unseen, plain) - loss(unseen, bent[joint]) for joint in joints}
    price = len(s.curve_degrees + s.loaded_degrees) * np.log(max(2, len(seen.G)))
    out = []
    for joint in dict.fromkeys(at):
        alike = [one for one in kind if kind[one] == kind[joint]]
        chance = max([float(gains[one].sum()) for one in alike if one not in at], default=0.0)
        without = plain.copy()
        for e in found:
            if e.target == joint:
                without[1 + evidence.keys.index((e.name, joint))] += e.value
        explained = float(np.sum(loss(unseen, without) - loss(unseen, plain)))
        gain = float(gains[joint].sum())
        low = np.percentile(block_bootstrap_counts(len(unseen.G), rng) @ gains[joint], 2.5)
        if low > 0 and gain > max(price, s.curve_others * chance, s.curve_worth * explained):
            by_channel = {}
            for channel in ANGLE_CHANNELS:
                weight = np.zeros_like(result.robust_weights.weight)
                columns = evidence.layout.channels[channel]
                weight[:, columns] = result.robust_weights.weight[:, columns]
                own = normal_equations(whole, sigma, weight, split.part)
                own = own.rows(own.part == SELECT)
                by_channel[channel] = float(np.sum(loss(own, plain) - loss(own, bent[joint])))
            channel = max(by_channel, key=lambda name: by_channel[name])
            out.append((gain, AngleError(joint, channel, gain / (gain + max(explained, 0.0)))))
    return tuple(one for _, one in sorted(out, key=lambda pair: -pair[0]))


def _curves_of(evidence: Evidence, joint: str) -> list[tuple[str, str]]:
    return [key for key in evidence.keys if key[0] == f"curve {joint}"]


def _with_curves(
    cases: Sequence[LogUnderModel], result: Attribution, joints: Sequence[str]
) -> Evidence:
    """Evidence of the effects found, extended by curves of the angles of these joints."""
    effects = [f.effect for f in result.found]
    known = result.evidence.only([(e.name, e.target) for e in effects])
    settings = cases[0].settings

    def basis(log: Log) -> list[dict[str, np.ndarray]]:
        return [c for joint in joints for c in angle_error_basis(log, joint, settings)]

    per_log = [wrt_columns(case, effects, basis) for case in cases]
    starts = np.searchsorted(known.log, np.arange(len(cases) + 1))
    curves = tuple(joined_regressor(list(parts), starts) for parts in zip(*per_log, strict=True))
    each = len(curves) // len(joints)
    names = tuple((f"curve {j}", str(i)) for j in joints for i in range(each))
    return replace(known, keys=(*known.keys, *names), X=(*known.X, *curves))


def angle_error_basis(
    log: Log, joint: str, settings: TraceSettings = DEFAULT
) -> list[dict[str, np.ndarray]]:
    """Basis of the error of a joint's measured angle [rad] and rate [rad/s], each (N,).

    Legendre polynomials of the angle, alone and, where the log has it, times the torque.
    """
    q = log.columns[f"q_{joint}"]
    weights = [(np.ones_like(q), settings.curve_degrees)]
    if f"tau_{joint}" in log.frame:
        rows = max(1, round(settings.torque_window * log.rate))
        torque = uniform_filter1d(log.columns[f"tau_{joint}"], rows)
        weights.append((torque, settings.loaded_degrees))
    changes = []
    for weight, degrees in weights:
        for degree in degrees:
            added = weight * Legendre.basis(degree, domain=[q.min(), q.max()])(q)
            change = {f"q_{joint}": added}
            if f"dq_{joint}" in log.frame:
                change[f"dq_{joint}"] = np.gradient(uniform_filter1d(added, 3), log.t)
            changes.append(change)
    return changes
