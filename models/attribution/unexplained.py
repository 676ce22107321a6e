"""Sparse regression of the residual that no effect explains on a library of simple regressors."""

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
from surefoot.models.attribution.weights import RobustWeights
from surefoot.models.residuals.layout import layout_for
from surefoot.sim.effects import Effect
from surefoot.sim.effects.contact import STICTION_RATE
from surefoot.sim.log import Log, joint_velocity


@dataclass(frozen=True)
class Unexplained:
    """A column of a channel, the regressors found for it, and the share that they explain.

    `regressors` is empty for a channel above its floor that no regressor explains.
    """

    channel: str
    column: str
    regressors: tuple[str, ...]
    share: float


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
    layout = layout_for(cases[0].robot.limbs)
    found = []
    for place, channel in enumerate(channels):
        columns = range(*layout.channels[channel].indices(layout.width))
        known = [c for c in columns if np.isfinite(left[seen, c]).any()]
        noise = {c: np.nanmean(left[seen, c] ** 2) / robust.sigma[c] ** 2 for c in known}
        before = len(found)
        for column in known:
            one = _column(
                values, left[:, column], robust.weight[:, column], seen, unseen, cases[0].settings
            )
            if one is not None:
                chosen, share = one
                regressors = tuple(names[i] for i in chosen)
                one = Unexplained(channel, layout.names[column], regressors, share)
                found.append(((place, -share * noise[column]), one))
        if noise and len(found) == before:
            loudest = max(noise, key=lambda c: noise[c])
            found.append(((place, 0.0), Unexplained(channel, layout.names[loudest], (), 0.0)))
    return tuple(one for _, one in sorted(found, key=lambda pair: pair[0]))


def regressor_library(cases: Sequence[LogUnderModel]) -> tuple[tuple[str, ...], np.ndarray]:
    """Names and values (M, R) of the regressors: standardised bin means."""
    tables = []
    names: list[str] = []
    for case in cases:
        log, first = case.log, case.motion.first
        count = np.diff(np.append(first, len(log.t)))[:, None]
        columns = {"time": log.t}
        for k in case.settings.settling_times:
            columns[f"settling_{k}_s"] = np.exp(-(log.t - log.t[0]) / k)
        if log.has("imu") and not case.fixed:
            columns |= _named("rate", log.gyro, "xyz") | _named("force", log.accel, "xyz")
        if not case.fixed:
            columns |= _named("velocity", case.motion.v_I, "xyz")
            columns |= _named("upward", case.motion.up_I, "xyz")
        if log.has("q"):
            dq = joint_velocity(log)
            columns |= _named("angle", log.q, log.joints) | _named("speed", dq, log.joints)
            columns |= _named("sense", np.tanh(dq / STICTION_RATE), log.joints)
            for k in case.settings.harmonics:
                columns |= _named(f"sin_{k}_angle", np.sin(k * log.q), log.joints)
                columns |= _named(f"cos_{k}_angle", np.cos(k * log.q), log.joints)
        if log.has("tau"):
            columns |= _named("torque", log.tau, log.joints)
        if log.has("contact"):
            columns |= _named("stance", log.contact.astype(float), log.legs)
        names = list(columns)
        rows = np.column_stack(list(columns.values()))
        tables.append(np.add.reduceat(rows, first, axis=0) / count)
    values = np.concatenate(tables)
    spread = values.std(axis=0)
    return tuple(names), (values - values.mean(axis=0)) / np.where(spread > 1e-12, spread, 1.0)


def _named(kind: str, values: np.ndarray, names: Sequence[str]) -> dict[str, np.ndarray]:
    return {f"{kind}_{name}": values[:, i] for i, name in enumerate(names)}


def _column(
    values: np.ndarray,
    y: np.ndarray,
    weight: np.ndarray,
    seen: np.ndarray,
    unseen: np.ndarray,
    settings: TraceSettings,
) -> tuple[list[int], float] | None:
    """Forward selection of regressors for one column, with the share explained; None if there are
    none.

    Args:
        values: (M, R), the regressors.
        y: (M,), the column's residual.
        weight: (M,), robust weights.
        seen: (M,) bool, bins of the fit.
        unseen: (M,) bool, bins on which the share is computed.
        settings: of the trace.
    """
    there = np.isfinite(y) & (weight > 0)
    fit, check = there & seen, there & unseen
    if fit.sum() < 50 or check.sum() < 50:
        return None
    root = np.sqrt(weight)[:, None]
    ones = np.ones((len(y), 1))
    chosen: list[int] = []
    share = 0.0
    while len(chosen) < settings.most_regressors:
        A = np.hstack([ones, values[:, chosen]]) * root
        base = _solve(A, y * root[:, 0], fit)
        rest = np.where(there, np.nan_to_num(y) * root[:, 0] - A @ base, 0.0)
        # The part of each regressor that is orthogonal to those chosen and to a constant.
        Q = np.linalg.qr(A[fit])[0]
        X = (values * root)[fit]
        own = X - Q @ (Q.T @ X)
        size = np.linalg.norm(own, axis=0)
        known = size < 1e-6 * np.maximum(np.linalg.norm(X, axis=0), 1e-12)
        pull = np.where(known, 0.0, np.abs(own.T @ rest[fit]) / np.maximum(size, 1e-12))
        best = int(np.argmax(pull))
        A = np.hstack([ones, values[:, [*chosen, best]]]) * root
        after = y[check] * root[check, 0] - A[check] @ _solve(A, y * root[:, 0], fit)
        plain = (y[check] - np.average(y[check], weights=weight[check])) * root[check, 0]
        gained = 1.0 - float(after @ after) / max(float(plain @ plain), 1e-300)
        if gained < share + settings.least_share:
            break
        chosen, share = [*chosen, best], gained
    return (chosen, share) if chosen else None


def _solve(A: np.ndarray, y: np.ndarray, rows: np.ndarray) -> np.ndarray:
    return np.linalg.lstsq(A[rows], y[rows], rcond=1e-10)[0]


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
