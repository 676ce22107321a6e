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

from surefoot.models.attribution.design import design
from surefoot.models.attribution.evidence import LogUnderModel, joined_regressor, wrt_columns
from surefoot.models.attribution.explain import Explanation
from surefoot.models.attribution.metric import Metric
from surefoot.models.attribution.settings import DEFAULT, TraceSettings
from surefoot.sim.effects import Effect
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
    result: Explanation, cases: Sequence[LogUnderModel], settings: TraceSettings
) -> tuple[AngleError, ...]:
    """Joints with an effect at which a curve of the angle explains more; the curve that explains
    most comes first.

    Args:
        result: of the search.
        cases: the logs, with their own zeros and clocks compensated.
        settings: of the trace.
    """
    found = [one.effect for one in result.found]
    limbs = result.metric.known.layout.limbs
    kind = {joint: limbs.kind(i) for i, joint in enumerate(limbs.joints)}
    at = [e.target for e in found if e.target in kind and "leg_velocity" in e.channels]
    if not at or cases[0].fixed:
        return ()
    joints = [joint for joint in kind if kind[joint] in {kind[one] for one in at}]
    metric = _with_curves(cases, found, result.metric, joints, settings)
    gains = {joint: _gain(metric, joint, found) for joint in joints}
    blocks = sum(np.ptp(case.log.t) for case in cases) / settings.block
    price = len(settings.curve_degrees + settings.loaded_degrees) * np.log(max(2.0, blocks))
    out = []
    for joint in dict.fromkeys(at):
        alike = [one for one in kind if kind[one] == kind[joint]]
        chance = max([gains[one] for one in alike if one not in at], default=0.0)
        explained = 0.0
        for e in (one for one in found if one.target == joint):
            place = 1 + metric.known.keys.index((e.name, joint))
            explained += e.value**2 * sum(G[place, place] for G in metric.grams)
        gain = gains[joint]
        if gain > max(price, settings.curve_others * chance, settings.curve_worth * explained):
            by_channel = {}
            for channel in ANGLE_CHANNELS:
                root = np.zeros_like(metric.root)
                columns = metric.known.layout.of(channel)
                root[:, columns] = metric.root[:, columns]
                by_channel[channel] = _gain(replace(metric, root=root), joint, found)
            channel = max(by_channel, key=lambda name: by_channel[name])
            out.append((gain, AngleError(joint, channel, gain / (gain + explained))))
    return tuple(one for _, one in sorted(out, key=lambda pair: -pair[0]))


def _gain(metric: Metric, joint: str, found: Sequence[Effect]) -> float:
    """Squared residual that the curves of a joint's angle explain beside the effects found."""
    keys, S = metric.known.keys, metric.S
    at = [1 + keys.index((e.name, e.target)) for e in found if (e.name, e.target) in keys]
    S = S - S[:, at] @ np.linalg.pinv(S[np.ix_(at, at)], hermitian=True) @ S[at]
    own = [1 + i for i, key in enumerate(keys) if key[0] == f"curve {joint}"]
    inverse = np.linalg.pinv(S[np.ix_(own, own)], hermitian=True, rcond=1e-9)
    return float(S[own, 0] @ inverse @ S[own, 0])


def _with_curves(
    cases: Sequence[LogUnderModel],
    effects: Sequence[Effect],
    metric: Metric,
    joints: Sequence[str],
    settings: TraceSettings,
) -> Metric:
    """A metric whose candidates include curves of the angles of these joints."""

    def basis(log: Log) -> list[dict[str, np.ndarray]]:
        return [c for joint in joints for c in angle_error_basis(log, joint, settings)]

    known = metric.known
    per_log = [wrt_columns(case, effects, basis) for case in cases]
    starts = np.searchsorted(known.log, np.arange(len(cases) + 1))
    curves = tuple(joined_regressor(list(parts), starts) for parts in zip(*per_log, strict=True))
    each = len(curves) // len(joints)
    names = tuple((f"curve {j}", str(i)) for j in joints for i in range(each))
    more = replace(known, keys=(*known.keys, *names), X=(*known.X, *curves))
    places = metric.places + len(names) * (metric.places >= len(known.keys))
    return replace(metric, data=design(more), places=places)


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
