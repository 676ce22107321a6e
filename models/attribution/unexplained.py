"""Form of the residual that no effect explains: encoder errors that are curves, and correlations.

An encoder offset, an encoder scale and joint compliance change the measured angle by a constant,
linearly in the angle, and in proportion to the torque. Eccentric magnets, ripple and cross-talk
change it by a nonlinear function of the angle, alone or times the torque, which no effect of the
catalogue models. Over the small range that a leg moves through, such a curve looks much like a
line, so an effect found at a joint is checked against Legendre polynomials of the angle.

Whatever else is left is regressed on a library of simple regressors.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import Legendre
from scipy.ndimage import uniform_filter1d

from surefoot.models.attribution.design import design
from surefoot.models.attribution.evidence import Changes, LogUnderModel, linearise
from surefoot.models.attribution.explain import Explanation
from surefoot.models.attribution.metric import Metric
from surefoot.models.attribution.weights import RobustWeights
from surefoot.models.bootstrap import BLOCK_SECONDS
from surefoot.models.residuals.binning import bin_mean
from surefoot.models.residuals.layout import layout_for
from surefoot.sim.effects import Effect
from surefoot.sim.log import Log, joint_velocity
from surefoot.sim.physics.loads import STICTION_RATE

CURVE_CHANNELS = ("leg_velocity", "foot_height", "base_wrench", "joint_torque")
"""Channels in which an error of a joint's angle shows."""
DEGREES, LOADED_DEGREES = (2, 3, 4, 5, 6), (1, 2, 3, 4)
"""Degrees of the polynomials over a joint's range of motion, alone and times the torque."""
CURVE_WORTH = 0.03
"""Share of what an effect explains that a curve of its joint's angle must add."""
CURVE_OTHERS = 3.0
"""Ratio of a curve's gain to that of the same joint on legs without an effect."""
_TORQUE_WINDOW = 0.03
"""Averaging time of a torque before differentiation [s]."""
MOST_REGRESSORS = 3
"""Maximum number of regressors for one column."""
LEAST_SHARE = 0.05
"""Share of a column's residual that a regressor must add on unseen blocks."""
FEWEST_BINS = 50
"""Bins of a column, of the fit and unseen, from which it is regressed."""
HARMONICS = (2, 3, 4, 6, 8, 10, 12)
"""Harmonics of a joint's angle, for errors periodic in the turns of a gear or motor."""
SETTLING_TIMES = (4, 8, 16, 32, 64)
"""Time constants of warm-up and settling after the log's first row [s]."""


@dataclass(frozen=True)
class Unexplained:
    """A column of a channel, the regressors found for it, and the share that they explain.

    `regressors` is empty for a channel above its floor that no regressor explains. For a joint
    whose measured angle is off by a curve of the angle, the column is the joint, and the share that
    of the curve in what it and the effects found at the joint explain together.
    """

    channel: str
    column: str
    regressors: tuple[str, ...]
    share: float


def curved_angles(result: Explanation, cases: Sequence[LogUnderModel]) -> tuple[Unexplained, ...]:
    """Joints with an effect at which a curve of the angle explains more; the curve that explains
    most comes first.

    Args:
        result: of the search.
        cases: the logs, with their own zeros and clocks compensated.
    """
    found, limbs = [one.effect for one in result.found], result.metric.known.layout.limbs
    kind = dict(zip(limbs.joints, limbs.kind_of, strict=True))
    at = [e.target for e in found if e.target in kind and "leg_velocity" in e.traced.channels]
    if not at or cases[0].fixed:
        return ()
    joints = [joint for joint in kind if kind[joint] in {kind[one] for one in at}]
    curves = linearise(
        cases,
        found,
        (),
        evaluation_channels=False,
        changes=lambda log: {k: x for joint in joints for k, x in angle_curves(log, joint).items()},
    )
    known, more = result.metric.known, len(curves.keys)
    known = replace(known, keys=(*known.keys, *curves.keys), X=(*known.X, *curves.X))
    places = result.metric.places + more * (result.metric.places >= len(known.keys) - more)
    metric = replace(result.metric, data=design(known), places=places)
    gains = {joint: _gain(metric, joint, found) for joint in joints}
    blocks = sum(np.ptp(case.log.t) for case in cases) / BLOCK_SECONDS
    price = len(DEGREES + LOADED_DEGREES) * np.log(max(2.0, blocks))
    energy = metric.grams.sum(axis=0)
    out = []
    for joint in dict.fromkeys(at):
        others = [gains[one] for one in joints if kind[one] == kind[joint] and one not in at]
        own = [e for e in found if e.target == joint]
        at_joint = [1 + known.keys.index((e.name, joint)) for e in own]
        sizes = np.array([e.value for e in own])
        explained = float(sizes @ energy[np.ix_(at_joint, at_joint)] @ sizes)
        gain, chance = gains[joint], max(others, default=0.0)
        if gain > max(price, CURVE_OTHERS * chance, CURVE_WORTH * explained):
            by_channel = {}
            for channel in CURVE_CHANNELS:
                root = np.zeros_like(metric.root)
                columns = known.layout.of(channel)
                root[:, columns] = metric.root[:, columns]
                by_channel[channel] = _gain(replace(metric, root=root), joint, found)
            channel = max(by_channel, key=lambda name: by_channel[name])
            share = gain / (gain + explained)
            out.append((gain, Unexplained(channel, joint, (f"curve_of_angle_{joint}",), share)))
    return tuple(one for _, one in sorted(out, key=lambda pair: -pair[0]))


def _gain(metric: Metric, joint: str, found: Sequence[Effect]) -> float:
    """Squared residual that the curves of a joint's angle explain beside the effects found."""
    keys, S = metric.known.keys, metric.S
    at = [1 + keys.index((e.name, e.target)) for e in found if (e.name, e.target) in keys]
    S = S - S[:, at] @ np.linalg.pinv(S[np.ix_(at, at)], hermitian=True) @ S[at]
    own = [1 + i for i, key in enumerate(keys) if key[0] == _curve(joint)]
    inverse = np.linalg.pinv(S[np.ix_(own, own)], hermitian=True, rcond=1e-9)
    return float(S[own, 0] @ inverse @ S[own, 0])


def _curve(joint: str) -> str:
    """Name of the candidates that are curves of a joint's angle."""
    return f"curve {joint}"


def angle_curves(log: Log, joint: str) -> Changes:
    """Basis of the error of a joint's measured angle [rad] and rate [rad/s], each (N,).

    Legendre polynomials of the angle, alone and, where the log has it, times the torque.
    """
    q = log.columns[f"q_{joint}"]
    weights: list[tuple[np.ndarray, tuple[int, ...]]] = [(np.ones_like(q), DEGREES)]
    if f"tau_{joint}" in log.frame:
        rows = max(1, round(_TORQUE_WINDOW * log.rate))
        weights.append((uniform_filter1d(log.columns[f"tau_{joint}"], rows), LOADED_DEGREES))
    changes = {}
    for weight, degrees in weights:
        for degree in degrees:
            added = weight * Legendre.basis(degree, domain=[q.min(), q.max()])(q)
            change = {f"q_{joint}": added}
            if f"dq_{joint}" in log.frame:
                change[f"dq_{joint}"] = np.gradient(uniform_filter1d(added, 3), log.t)
            changes[_curve(joint), str(len(changes))] = change
    return changes


def sparse_regression(
    cases: Sequence[LogUnderModel],
    left: np.ndarray,
    robust: RobustWeights,
    channels: Sequence[str],
    seen: np.ndarray,
    unseen: np.ndarray,
) -> tuple[Unexplained, ...]:
    """Regress the unexplained residual of some channels on the library.

    Results are in the order of the channels and, within each, of the error explained, in units of
    noise. A channel without a regressor is represented by its largest column.

    Args:
        cases: the logs under the model.
        left: residual (M, W) of the bins, in units of the columns; NaN where there is none.
        robust: weights (M, W) and noise (W,) of the residual.
        channels: names of the channels.
        seen: (M,) bool, bins of the forward selection.
        unseen: (M,) bool, bins on which shares are computed.
    """
    names, values = regressor_library(cases)
    layout, out = layout_for(cases[0].robot.limbs), []
    for channel in channels:
        noise, forms = {}, []
        for c in (c for c in layout.of(channel) if np.isfinite(left[seen, c]).any()):
            column = layout.names[c]
            noise[column] = np.nanmean(left[seen, c] ** 2) / robust.sigma[c] ** 2
            chosen, share = _column(values, left[:, c], robust.weight[:, c], seen, unseen)
            if chosen:
                regressors = tuple(names[i] for i in chosen)
                forms.append(Unexplained(channel, column, regressors, share))
        if noise and not forms:
            loudest = max(noise, key=lambda column: noise[column])
            forms.append(Unexplained(channel, loudest, (), 0.0))
        out += sorted(forms, key=lambda one: -one.share * noise[one.column])
    return tuple(out)


def regressor_library(cases: Sequence[LogUnderModel]) -> tuple[tuple[str, ...], np.ndarray]:
    """Names and values (M, R) of the regressors: standardised bin means."""
    tables, columns = [], {}
    for case in cases:
        log, motion = case.log, case.motion
        columns = {"time": log.t}
        columns |= {f"settling_{k}_s": np.exp(-(log.t - log.t[0]) / k) for k in SETTLING_TIMES}
        groups = []
        if log.has("imu") and not case.fixed:
            groups += [("rate", log.gyro, "xyz"), ("force", log.accel, "xyz")]
        if not case.fixed:
            groups += [("velocity", motion.v_I, "xyz"), ("upward", motion.up_I, "xyz")]
        if log.has("q"):
            dq, joints = joint_velocity(log), log.joints
            groups += [("angle", log.q, joints), ("speed", dq, joints)]
            groups += [("sense", np.tanh(dq / STICTION_RATE), joints)]
            for k in HARMONICS:
                groups += [(f"sin_{k}_angle", np.sin(k * log.q), joints)]
                groups += [(f"cos_{k}_angle", np.cos(k * log.q), joints)]
        if log.has("tau"):
            groups += [("torque", log.tau, log.joints)]
        if log.has("contact"):
            groups += [("stance", log.contact.astype(float), log.legs)]
        for kind, of_group, parts in groups:
            columns |= {f"{kind}_{one}": x for one, x in zip(parts, of_group.T, strict=True)}
        tables.append(bin_mean(motion)(np.column_stack([*columns.values()])))
    values = np.concatenate(tables)
    spread = values.std(axis=0)
    scaled = (values - values.mean(axis=0)) / np.where(spread > 1e-12, spread, 1.0)
    return tuple(columns), scaled


def _column(
    values: np.ndarray, y: np.ndarray, weight: np.ndarray, seen: np.ndarray, unseen: np.ndarray
) -> tuple[list[int], float]:
    """Forward selection of regressors for one column, with the share explained.

    Args:
        values: (M, R), the regressors.
        y: (M,), the column's residual.
        weight: (M,), robust weights.
        seen: (M,) bool, bins of the fit.
        unseen: (M,) bool, bins on which the share is computed.
    """
    there = np.isfinite(y) & (weight > 0)
    fit, check = there & seen, there & unseen
    if min(fit.sum(), check.sum()) < FEWEST_BINS:
        return [], 0.0
    root = np.sqrt(weight)[:, None]
    X, rest = values * root, y * root[:, 0]
    plain = (y[check] - np.average(y[check], weights=weight[check])) * root[check, 0]
    A, chosen, share = root, [], 0.0
    while len(chosen) < MOST_REGRESSORS:
        # The part of each regressor that is orthogonal to those chosen and to a constant.
        Q = np.linalg.qr(A[fit])[0]
        own = X[fit] - Q @ (Q.T @ X[fit])
        size = np.linalg.norm(own, axis=0)
        new = size > 1e-6 * np.maximum(np.linalg.norm(X[fit], axis=0), 1e-12)
        pull = np.where(new, np.abs(own.T @ rest[fit]) / np.maximum(size, 1e-12), 0.0)
        best = int(np.argmax(pull))
        A = np.column_stack([A, X[:, best]])
        after = rest[check] - A[check] @ np.linalg.lstsq(A[fit], rest[fit], rcond=1e-10)[0]
        gained = 1.0 - float(after @ after) / max(float(plain @ plain), 1e-300)
        if gained < share + LEAST_SHARE:
            break
        chosen, share = [*chosen, best], gained
    return chosen, share
