"""Evidence of a trace: residuals of logs and their derivatives with respect to each effect."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from surefoot.models.residuals.binning import (
    ReferenceMotion,
    angles_are_quieter,
    at_rows,
    at_torques,
    bin_mean,
    mean_rate_of_change,
)
from surefoot.models.residuals.channel import ResidualInputs
from surefoot.models.residuals.contact_timing import CHANGE_WINDOW
from surefoot.models.residuals.jacobians import (
    CHAINED_CHANNELS,
    Regressor,
    ResidualJacobians,
    explained_share,
    residual_jacobians,
    sparse,
    unchanged_channels,
    wrt_readings,
    wrt_robot,
)
from surefoot.models.residuals.layout import Layout, layout_for
from surefoot.models.residuals.registry import channels
from surefoot.models.residuals.residual import (
    ResidualTable,
    filled,
    motion_under_model,
    residual,
    with_ground,
)
from surefoot.sim.common.sources import code_digest
from surefoot.sim.effects import Effect, compensate_all, effect, known_effects
from surefoot.sim.effects.base import changed_columns, with_columns
from surefoot.sim.log import Log, MemoisedLog
from surefoot.sim.log.derived import JOINT_WINDOW, derivative
from surefoot.sim.robot.machine import Machine
from surefoot.sim.sensors.streams import Sensors

Key = tuple[str, str]
"""A candidate: name and target of an effect."""


FIXED_BASE_RATE = 0.1
"""RMS of the gyro below which a base is taken to be fixed [rad/s]: a trot has at least 0.2, the
bias of a bad gyro 0.05.
"""
_CHANGE_STEP = 1e-3
"""Relative step of the finite differences of channels without a chain rule."""
FEW_BINS = 0.02
"""Share of a table's entries that may appear or vanish before its derivatives are recomputed."""


@dataclass(frozen=True)
class Evidence:
    """Residuals of M bins as a linear model: table = X sizes + Z nuisance parameters + noise.

    Attributes:
        layout: names and groups of the W columns.
        t: time of each bin (M,) [s].
        log: index of the log that each bin is from (M,).
        table: residuals (M, W), NaN where a bin has none.
        keys: the C candidates.
        X: regressor of each candidate.
        Z: regressors of the B nuisance parameters: turn-on biases of each log's IMU, and the ground
            plane of each log.
        deviations: prior standard deviations of the nuisance parameters (B,), infinite where free.
        bias_of: for each of Z that is a turn-on bias, the candidate that describes the same error
            without a bound, else None.
        groups: candidates whose regressor is the sum of those of other candidates.
        reading_scale: factors of the columns of each log (`_reading_scale`).
    """

    layout: Layout
    t: np.ndarray
    log: np.ndarray
    table: np.ndarray
    keys: tuple[Key, ...]
    X: tuple[Regressor, ...]
    Z: tuple[Regressor, ...]
    deviations: np.ndarray
    bias_of: tuple[Key | None, ...]
    groups: frozenset[Key] = frozenset()
    reading_scale: tuple[tuple[float, ...], ...] = ()

    @cached_property
    def single(self) -> np.ndarray:
        """Mask (C + B,) of the candidates and nuisance parameters that are no sum of others."""
        return np.array([key not in self.groups for key in (*self.keys, *(None,) * len(self.Z))])

    def only(self, keys: Sequence[Key]) -> "Evidence":
        """The evidence restricted to these candidates."""
        X = tuple(self.X[self.keys.index(key)] for key in keys)
        return replace(self, keys=tuple(keys), X=X)


@dataclass(frozen=True)
class LogUnderModel:
    """A log, the model that it is compared with, and the motion of its reference.

    Attributes:
        log: its readings, with the declared effects compensated.
        robot: the model.
        motion: of the base.
        fixed: whether the base cannot move.
        zeros: effects of the log's own, such as encoder zeros, that it has compensated.
        undriven: joints without a drive (`passive_joints`); of a fixed base.
    """

    log: Log
    robot: Machine
    motion: ReferenceMotion
    fixed: bool = False
    zeros: tuple[Effect, ...] = ()
    undriven: tuple[str, ...] = ()

    @property
    def by_feet(self) -> bool:
        """Whether the machine is known by the feet that its logs give, without a robot model."""
        return self.robot.limbs.feet_alone


def log_under_model(
    log: Log, robot: Machine, undriven: tuple[str, ...] | None = None
) -> LogUnderModel:
    """Prepare a log for comparison with a robot model.

    Without a reference, the base is assumed to be fixed if the log shows neither ground contact nor
    rotation of the body. undriven: joints without a drive, by default of the log; compensated
    friction would hide them.
    """
    stands = log.has("contact") and log.contact.any()
    turns = log.has("imu") and np.sqrt(np.mean(np.square(log.gyro))) > FIXED_BASE_RATE
    hung = not log.has("reference") and not (stands or turns) and log.has("q")
    fixed = robot.fixed or hung
    log = MemoisedLog.of(log)
    motion = motion_under_model(log, robot, fixed)
    if fixed and log.has("tau") and angles_are_quieter(log, motion):
        motion = replace(motion, rates_of_angles=True)
    if undriven is None:
        undriven = passive_joints(log) if fixed else ()
    motion = with_ground(motion, log, robot)
    return LogUnderModel(log, robot, motion, fixed, undriven=undriven)


def channels_of(case: LogUnderModel) -> tuple[str, ...]:
    """The channels that a log has the columns for."""
    layout = layout_for(case.robot.limbs)
    return tuple(
        name
        for name, channel in channels().items()
        if name in layout
        and channel.is_available(case.log, case.fixed, case.motion.level, case.by_feet)
    )


def all_keys(case: LogUnderModel) -> tuple[Key, ...]:
    """Every candidate that can be compensated and has a channel in the log."""
    there, legged, limbs, keys = {*channels_of(case)}, case.robot.legged, case.robot.limbs, []
    for kind in known_effects().usable()[0].values():
        lacks = case.fixed and "reference" in kind.needs
        if not kind.is_compensated() or lacks or not kind.is_compensated_on(case.log):
            continue
        if case.by_feet and not kind.on_given_feet:
            continue
        of_torques = getattr(kind, "readings", ()) == ("tau",)
        keys += [
            (kind.name, target)
            for target in kind.targets_on(limbs)
            if there & {*kind.channels_of(target)}
            # A joint without a drive has no reading of a torque that may err.
            and not (of_torques and {*kind.members_of(target, limbs)} <= {*case.undriven})
            and not (legged is not None and kind.equals_another(target, legged))
        ]
    return tuple(keys)


def passive_joints(log: Log) -> tuple[str, ...]:
    """Joints without a drive: their torque is always zero."""
    if not log.has("tau"):
        return ()
    return tuple(j for j, tau in zip(log.joints, log.tau.T, strict=True) if not tau.any())


def candidates_digest() -> str:
    """Digest of the code of every effect and residual channel, plug-ins included."""
    kinds = [*known_effects().values(), *map(type, channels().values())]
    return code_digest(*kinds)


def linearise(
    cases: Sequence[LogUnderModel],
    chosen: Sequence[Effect],
    keys: Sequence[Key],
    before: Evidence | None = None,
    evaluation_channels: bool = True,
) -> Evidence:
    """Compute residuals with `chosen` compensated, and their derivatives with respect to `keys`.

    A candidate among the chosen is linearised at its value, by central differences of the residual;
    any other at zero, by the chain rule where it has one. The latter derivatives change little with
    the chosen effects, so those of an evidence `before` may be reused.

    Args:
        cases: the logs under the declared model.
        chosen: effects that are compensated.
        keys: of the candidates.
        before: an evidence whose derivatives may be reused.
        evaluation_channels: whether to compute the channels that are never fitted.
    """
    parts = [_Linear(case, chosen, evaluation_channels) for case in cases]
    tables, reading_scale = [p.table for p in parts], tuple(tuple(p.reading_scale) for p in parts)
    starts = np.cumsum([0] + [len(table) for table in tables])
    same = before is not None and before.reading_scale == reading_scale
    if before is not None and same and _same_bins(before, np.concatenate(tables)):
        own = {(e.name, e.target) for e in chosen}
        if any(part.contacts_differ for part in parts):
            # The same bins may be in stance and yet a different set of feet share the load.
            own |= {key for key in before.keys if known_effects()[key[0]].uses_loads}
        X = tuple(
            joined_regressor([p.regressor(key) for p in parts], starts) if key in own else one
            for key, one in zip(before.keys, before.X, strict=True)
        )
        return replace(before, table=np.concatenate(tables), X=X)
    X = tuple(joined_regressor([p.regressor(key) for p in parts], starts) for key in keys)
    Z, deviations, bias_of = [], [], []
    for i, part in enumerate(parts):
        for one, deviation, key in part.nuisance_regressors():
            whole = np.zeros((starts[-1], len(one.columns)))
            whole[starts[i] : starts[i + 1]] = one.values
            Z.append(Regressor(one.columns, whole))
            deviations.append(deviation)
            bias_of.append(key)
    log = np.repeat(np.arange(len(parts)), np.diff(starts))
    return Evidence(
        layout=parts[0].parts.layout,
        t=np.concatenate([p.parts.t for p in parts]),
        log=log,
        table=np.concatenate(tables),
        keys=tuple(keys),
        X=X,
        Z=tuple(Z),
        deviations=np.array(deviations),
        bias_of=tuple(bias_of),
        reading_scale=reading_scale,
        groups=frozenset(
            (name, target)
            for name, target in keys
            if target in known_effects()[name].group_targets(cases[0].robot.limbs)
        ),
    )


def with_changes(
    known: Evidence,
    cases: Sequence[LogUnderModel],
    chosen: Sequence[Effect],
    changes: Callable[[Log], Mapping[Key, Mapping[str, np.ndarray]]],
) -> Evidence:
    """The evidence with further candidates.

    Args:
        known: evidence of the cases.
        cases: the logs.
        chosen: effects that are compensated.
        changes: candidate -> what one unit of it adds to columns of a log, each (N,).
    """
    starts, per_log = np.searchsorted(known.log, np.arange(len(cases) + 1)), []
    for case in cases:
        linear = _Linear(case, chosen)
        added = changes(linear.log)
        per_log.append([linear.by_columns(columns) for columns in added.values()])
    X = [joined_regressor(parts, starts) for parts in zip(*per_log, strict=True)]
    return replace(known, keys=(*known.keys, *added), X=(*known.X, *X))


def table_of(
    case: LogUnderModel, chosen: Sequence[Effect], evaluation_channels: bool = True
) -> np.ndarray:
    """Residual table (M, W) of a case with `chosen` compensated.

    Without `evaluation_channels`, the channels that are only evaluated and never fitted are NaN.
    """
    parts = _parts(case, chosen, evaluation_channels)[2]
    return _table(case, chosen, parts) * _reading_scale(case, chosen)


def _reading_scale(case: LogUnderModel, chosen: Sequence[Effect]) -> np.ndarray:
    """Factors (W,) of the columns that bring residuals back to the scale of the readings.

    Compensating a scale of a reading divides its residual by it, noise included, so that the
    largest scale would leave the least; with masses that shrink as well, next to nothing.
    """
    layout = layout_for(case.robot.limbs)
    factor = np.ones(layout.width)
    for one in chosen:
        columns = _SCALED.get(one.name, ())
        if columns:
            parts = one.members(case.robot.limbs)
            scaled = {f"{column}_{part}" for column in columns for part in parts}
            factor[[name in scaled for name in layout.names]] *= 1.0 + one.value
    return factor


_SCALED = {
    "torque_scale": ("torque", "command"),
    "gyro_scale": ("gyro",),
    "accel_scale": ("accel",),
}
"""Effect that scales a reading -> columns of the residual that have its unit, by its parts."""


def _parts(
    case: LogUnderModel, chosen: Sequence[Effect], evaluation_channels: bool = True
) -> tuple[Log, Machine, ResidualTable, ReferenceMotion]:
    log, robot = compensate_all(chosen, case.log, case.robot)
    motion = case.motion
    if log is not case.log and _changes_motion(changed_columns(case.log, log)):
        motion = replace(
            motion_under_model(log, robot, case.fixed),
            level=case.motion.level,
            normal_G=case.motion.normal_G,
        )
    names = [
        name
        for name, channel in channels().items()
        if evaluation_channels or not channel.evaluation_only
    ]
    return log, robot, residual(log, robot, motion, names), motion


def _table(case: LogUnderModel, chosen: Sequence[Effect], parts: ResidualTable) -> np.ndarray:
    """The table (M, W) of `parts`, each channel without the effects that are unseen by it."""
    unseen = {name for one in chosen for name in one.unseen_by}
    table, motion = parts.table.copy(), parts.inputs.motion
    for name in unseen.intersection(parts.names):
        seen = [one for one in chosen if name not in one.unseen_by]
        log, robot = compensate_all(seen, case.log, case.robot)
        columns = parts.layout.of(name)
        table[:, columns] = residual(log, robot, motion, [name]).table[:, columns]
    return table


class _Linear:
    """Residual of one log with the chosen effects compensated, and its derivatives."""

    def __init__(
        self, case: LogUnderModel, chosen: Sequence[Effect], evaluation_channels: bool = True
    ):
        self.case, self.chosen = case, list(chosen)
        self.log, self.robot, self.parts, self.motion = _parts(case, chosen, evaluation_channels)
        self.joints = self.log.joints
        self.reading_scale = _reading_scale(case, chosen)
        self.table = _table(case, chosen, self.parts) * self.reading_scale
        self.contacts_differ = self.motion is not case.motion and any(
            name.startswith("contact_") for name in changed_columns(case.log, self.log)
        )
        self._known: dict[Key, Regressor] = {}

    @cached_property
    def jacobians(self) -> ResidualJacobians:
        return residual_jacobians(self.parts, self.robot)

    def regressor(self, key: Key) -> Regressor:
        """Derivative of the residual table with respect to the size of `key`."""
        if key not in self._known:
            self._known[key] = self._regressor(key)
        return self._known[key]

    def _regressor(self, key: Key) -> Regressor:
        if any((e.name, e.target) == key for e in self.chosen):
            return self._derivative_at_value(key)
        kind = known_effects()[key[0]]
        members = kind.members_of(key[1], self.robot.limbs)
        if members != (key[1],):
            # To first order, a group of equal sizes is the sum of its members.
            return summed_regressor([self.regressor((key[0], member)) for member in members])
        sizes = kind.starts_on(key[1], self.log)
        tried = [self._derivative_at_zero(key, size) for size in sizes]
        if len(tried) == 1:
            return tried[0]
        # A start of either sign is valid for sizes of that sign; take the one that agrees best.
        shares = [explained_share(one, self.table) for one in tried]
        return tried[int(np.argmax(np.sign(sizes) * shares))]

    def _derivative_at_zero(self, key: Key, step: float) -> Regressor:
        """Derivative at zero, by a difference of the residual or the effect's chain rule."""
        log, robot = compensate_all([effect(*key, step)], self.log, self.robot)
        rule = known_effects()[key[0]].chain_rule
        if rule == "readings":
            change = self._by_chain_rule(log, step)
            self._add_change_without_chain_rule(change, log, robot, step)
        elif rule is not None and robot is not self.robot:
            change = wrt_robot(self.parts, self.robot, robot, step)
        else:
            change = self._by_difference(key, log, robot, step)
        if key[0] in _SCALED:
            by_scale = (_reading_scale(self.case, [effect(*key, step)]) - 1.0) / step
            change = change + by_scale * self.parts.table
        one = self._to_reading_scale(self._where_it_shows(key, sparse(change, self.parts.table)))
        return Regressor(one.columns, -one.values)

    def _to_reading_scale(self, one: Regressor) -> Regressor:
        """A regressor of the residual as one of the table."""
        return Regressor(one.columns, one.values * self.reading_scale[one.columns])

    def by_columns(self, added: Mapping[str, np.ndarray]) -> Regressor:
        """Regressor of additions (N,) to columns of the log."""
        columns = {name: self.log.columns[name] + x for name, x in added.items()}
        change = self._by_chain_rule(with_columns(self.log, columns), 1.0)
        small = {n: self.log.columns[n] + _CHANGE_STEP * x for n, x in added.items()}
        self._add_change_without_chain_rule(
            change, with_columns(self.log, small), self.robot, _CHANGE_STEP
        )
        return self._to_reading_scale(sparse(change, self.parts.table))

    def _by_chain_rule(self, log: Log, step: float) -> np.ndarray:
        """Change of the table (M, W) per unit, by the chain rule, for a `log` that is `step` units
        away.
        """
        change = _change(self.log, log, self.joints, self.motion, step)
        return wrt_readings(self.parts, self.jacobians, change)

    def _add_change_without_chain_rule(
        self, change: np.ndarray, log: Log, robot: Machine, step: float
    ) -> None:
        """Add to `change` (M, W), by differences, the channels without a chain rule."""
        layout, inputs = self.parts.layout, ResidualInputs(log, robot, self.motion)
        names = [name for name in layout.channels if name not in CHAINED_CHANNELS]
        columns = layout.of(*names)
        after = filled(layout, inputs, names)[:, columns]
        change[:, columns] += np.nan_to_num(after - self.parts.table[:, columns]) / step

    def _derivative_at_value(self, key: Key) -> Regressor:
        step = known_effects()[key[0]].step_of(key[1])
        ahead, behind = (
            table_of(self.case, _with_size_step(self.chosen, key, s), evaluation_channels=False)
            for s in (step, -step)
        )
        return self._where_it_shows(key, sparse((behind - ahead) / (2 * step), self.parts.table))

    def _where_it_shows(self, key: Key, one: Regressor) -> Regressor:
        """Restrict the regressor of an effect to channels in which it shows.

        Of one that shows only in the times of events, this removes the changes of other channels,
        which come from stances with more or fewer samples, and events that were lost or matched to
        a neighbour.
        """
        names = _event_channels(key)
        if not names:
            seen = ~np.isin(one.columns, self.parts.layout.of(*known_effects()[key[0]].unseen_by))
            return Regressor(one.columns[seen], one.values[:, seen])
        own = np.isin(one.columns, self.parts.layout.of(*names))
        values, step = one.values[:, own], known_effects()[key[0]].step_of(key[1])
        return Regressor(
            one.columns[own], np.where(np.abs(step * values) < CHANGE_WINDOW, values, 0.0)
        )

    def _by_difference(self, key: Key, log: Log, robot: Machine, step: float) -> np.ndarray:
        motion, same = self.motion, ()
        if log is self.log:
            same = unchanged_channels(self.robot, robot)
        elif _changes_motion(changed_columns(self.log, log)):
            motion = replace(motion_under_model(log, robot, self.case.fixed), level=motion.level)
        only = _event_channels(key) or self.parts.names
        again = [name for name in self.parts.names if name in only and name not in same]
        if len(known_effects()[key[0]].starts_on(key[1], self.log)) == 1:
            # No fit uses those; they only help to choose between several starts.
            again = [name for name in again if not channels()[name].evaluation_only]
        return (residual(log, robot, motion, again).table - self.parts.table) / step

    def nuisance_regressors(self) -> list[tuple[Regressor, float, Key | None]]:
        """Nuisance parameters of the log: regressor, prior standard deviation, and the candidate
        with the same meaning.
        """
        out: list[tuple[Regressor, float, Key | None]] = []
        parts, sensors = self.parts, Sensors()
        if not self.case.fixed and self.case.log.has("imu"):
            deviations = {"gyro": sensors.gyro_turn_on, "accel": sensors.accel_turn_on}
            for axis, name in enumerate("xyz"):
                for kind, turn_on in deviations.items():
                    ones = {axis: np.ones(len(parts.t))}
                    unit = {kind: ones} | ({"omega": ones} if kind == "gyro" else {})
                    one = sparse(wrt_readings(parts, self.jacobians, unit), parts.table)
                    out.append((one, turn_on, (f"{kind}_bias", name)))
        for name, columns in parts.layout.channels.items():
            for values in channels()[name].nuisance_regressors(parts.inputs):
                which = parts.layout.of(name)
                there = np.isfinite(parts.table[:, columns])
                one = self._to_reading_scale(Regressor(which, there * values))
                out.append((one, np.inf, None))
        return out


def _event_channels(key: Key) -> tuple[str, ...]:
    """Channels of an effect that shows only in the times of events; none for any other."""
    names = known_effects()[key[0]].channels_of(key[1])
    of_events = all(name in channels() and channels()[name].of_events for name in names)
    return tuple(names) if of_events else ()


def _changes_motion(columns: Sequence[str]) -> bool:
    return any(name.startswith(("ref_", "contact_")) for name in columns)


def _with_size_step(chosen: Sequence[Effect], key: Key, step: float) -> list[Effect]:
    return [effect(*key, e.value + step) if (e.name, e.target) == key else e for e in chosen]


def _change(
    old: Log, new: Log, joints: Sequence[str], motion: ReferenceMotion, step: float
) -> dict[str, dict[int, np.ndarray]]:
    """Change of each stream per unit of an effect: stream -> index -> means over bins (M,).

    Args:
        old: log before the change.
        new: log after it; its attrs name the columns that changed.
        joints: names, in the order of the columns.
        motion: reference motion of the log, with its bins.
        step: size of the change, in the effect's unit.
    """
    change: dict[str, dict[int, np.ndarray]] = {}
    mean = bin_mean(motion)
    for name in changed_columns(old, new):
        stream, _, what = name.partition("_")
        if stream in ("gyro", "accel"):
            place = "xyz".index(what)
        elif what in joints:
            place = joints.index(what)
        else:
            continue
        rows = new.columns[name] - old.columns[name]
        means = {stream: mean(rows)}
        if stream == "gyro":
            means["omega"] = mean(at_rows(rows))
        elif stream == "q" or (stream == "dq" and not motion.rates_of_angles):
            means |= _joint_bin_means(stream, rows, old.t, motion)
        if stream == "q" and (motion.rates_of_angles or not old.has("dq")):
            # Joint rates that were not logged are derived from the angles.
            rates = derivative(old.t, rows[:, None], JOINT_WINDOW, causal=False)[:, 0]
            means |= _joint_bin_means("dq", rates, old.t, motion)
            if not old.has("dq"):
                means["dq"] = mean(rates)
        for kind, values in means.items():
            change.setdefault(kind, {})[place] = values / step
    return change


def _joint_bin_means(
    stream: str, rows: np.ndarray, t: np.ndarray, motion: ReferenceMotion
) -> dict[str, np.ndarray]:
    """Bin means, at the times of the torques, of a change of angle or rate (N,); for a rate, also
    of its derivative.
    """
    means = {f"{stream}_step": bin_mean(motion)(at_torques(rows, motion))}
    if stream == "dq":
        means["ddq"] = mean_rate_of_change(rows, t, motion)
    return means


def _same_bins(before: Evidence, table: np.ndarray) -> bool:
    """Whether a table (M, W) has values in nearly the same fitted entries as the evidence.

    Different contacts mean different stances; a few bins at their ends do not matter.
    """
    fitted = before.layout.fitted
    there, now = np.isfinite(before.table[:, fitted]), np.isfinite(table[:, fitted])
    if there.shape != now.shape:
        return False
    return int(np.count_nonzero(there != now)) <= FEW_BINS * int(np.count_nonzero(there))


def summed_regressor(parts: Sequence[Regressor]) -> Regressor:
    """The sum of several regressors of one log."""
    columns = np.unique(np.concatenate([p.columns for p in parts]))
    values = np.zeros((len(parts[0].values), len(columns)))
    for part in parts:
        values[:, np.searchsorted(columns, part.columns)] += part.values
    return Regressor(columns, values)


def joined_regressor(parts: Sequence[Regressor], starts: np.ndarray) -> Regressor:
    """Concatenate the regressors of several logs."""
    if len(parts) == 1:
        return parts[0]
    columns = np.unique(np.concatenate([p.columns for p in parts]))
    values = np.zeros((starts[-1], len(columns)))
    for i, part in enumerate(parts):
        values[starts[i] : starts[i + 1], np.searchsorted(columns, part.columns)] = part.values
    return Regressor(columns, values)
