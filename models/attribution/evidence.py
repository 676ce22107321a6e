"""Evidence of a trace: residuals of logs and their derivatives with respect to each effect."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, takewhile

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
from surefoot.models.residuals.channels import channels
from surefoot.models.residuals.contact_timing import CHANGE_WINDOW
from surefoot.models.residuals.jacobians import (
    CHAINED_CHANNELS,
    Regressor,
    ResidualJacobians,
    explained_share,
    sparse,
    unchanged_channels,
    under_model,
)
from surefoot.models.residuals.layout import Layout, ResidualTable, filled, layout_for, residual
from surefoot.models.residuals.motion import motion_under_model, with_ground
from surefoot.sim.common.sources import code_digest
from surefoot.sim.effects import Effect, compensate_all, effect, in_order, known_effects
from surefoot.sim.effects.base import AXES, changed_columns, with_columns
from surefoot.sim.effects.readings import Scale
from surefoot.sim.log import Log, MemoisedLog
from surefoot.sim.log.derived import JOINT_WINDOW, derivative
from surefoot.sim.robot.machine import Machine
from surefoot.sim.sensors.streams import Sensors

Key = tuple[str, str]
"""A candidate: name and target of an effect."""
Changes = Mapping[Key, Mapping[str, np.ndarray]]
"""Candidate -> what one unit of it adds to columns of a log, each (N,)."""

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
        springs: those of the declared effects that are unseen by some channels.
        unsprung: the readings without these compensated; None where there are none.
    """

    log: Log
    robot: Machine
    motion: ReferenceMotion
    fixed: bool = False
    zeros: tuple[Effect, ...] = ()
    undriven: tuple[str, ...] = ()
    springs: tuple[Effect, ...] = ()
    unsprung: Log | None = None

    @property
    def by_feet(self) -> bool:
        """Whether the machine is known by the feet that its logs give, without a robot model."""
        return self.robot.limbs.feet_alone


def slowest_rate(cases: Sequence[LogUnderModel]) -> float:
    """The lowest rate of some logs [Hz]."""
    return min(case.log.rate for case in cases)


def log_under_model(
    log: Log,
    robot: Machine,
    declared: Sequence[Effect] = (),
    undriven: tuple[str, ...] | None = None,
) -> LogUnderModel:
    """Prepare a log for comparison with a robot model and declared effects.

    Without a reference, the base is assumed to be fixed if the log shows neither ground contact nor
    rotation of the body.

    Args:
        log: the readings.
        robot: the model.
        declared: effects to compensate.
        undriven: joints without a drive, by default of the log as it is: compensated friction would
            hide them.
    """
    read, springs = log, tuple(one for one in declared if one.traced.unseen_by)
    if springs:
        others = [one for one in declared if one not in springs]
        unsprung = compensate_all(others, log, robot)[0]
    else:
        unsprung = None
    log, robot = compensate_all(declared, log, robot)
    stands = log.has("contact") and log.contact.any()
    turns = log.has("imu") and np.sqrt(np.mean(np.square(log.gyro))) > FIXED_BASE_RATE
    hung = not log.has("reference") and not (stands or turns) and log.has("q")
    fixed = robot.fixed or hung
    log = MemoisedLog.of(log)
    motion = motion_under_model(log, robot, fixed)
    if fixed and log.has("tau") and angles_are_quieter(log, motion):
        motion = replace(motion, rates_of_angles=True)
    if undriven is None:
        undriven = passive_joints(read) if fixed else ()
    motion = with_ground(motion, log, robot)
    return LogUnderModel(log, robot, motion, fixed, (), undriven, springs, unsprung)


def with_compensated(case: LogUnderModel, effects: Sequence[Effect]) -> LogUnderModel:
    """A log with more effects compensated, such as its zeros."""
    more = log_under_model(case.log, case.robot, effects, case.undriven)
    if case.unsprung is None:
        return more
    unsprung = compensate_all(effects, case.unsprung, case.robot)[0]
    return replace(more, springs=case.springs, unsprung=unsprung)


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
        lacks = case.fixed and "reference" in kind.traced.needs
        if lacks or not (kind.is_compensated() and kind.traced.by_search):
            continue
        if case.by_feet and not kind.traced.on_given_feet:
            continue
        keys += [
            (kind.name, target)
            for target in kind.targets_on(limbs)
            if kind.is_compensated_on(case.log, target)
            and there & {*kind.traced_at(target).channels}
            and not (kind.by_torque and {*kind.members_of(target, limbs)} <= {*case.undriven})
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
    nuisance: bool = True,
    changes: Callable[[Log], Changes] = lambda log: {},
    moved: Collection[Key] = (),
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
        nuisance: whether to compute the nuisance parameters.
        changes: of a log, further candidates that are no effects.
        moved: candidates of which the cases have other sizes than those of the evidence `before`.
    """
    logs = [_Linear(case, chosen, evaluation_channels) for case in cases]
    starts, table = (
        np.cumsum([0] + [len(one.table) for one in logs]),
        np.concatenate([one.table for one in logs]),
    )
    scale = tuple(tuple(one.reading_scale) for one in logs)

    def regressor(key: Key) -> Regressor:
        return joined_regressor([one.regressor(key) for one in logs], starts)

    if before is not None and before.reading_scale == scale and _same_bins(before, table):
        stale = {(e.name, e.target) for e in chosen} | {*moved}
        if any(one.contacts_differ for one in logs):
            # The same bins may be in stance and yet a different set of feet share the load.
            stale |= {key for key in before.keys if known_effects()[key[0]].traced.uses_loads}
        known = zip(before.keys, before.X, strict=True)
        X = tuple(regressor(key) if key in stale else one for key, one in known)
        return replace(before, table=table, X=X)
    added = [{key: one.by_columns(x) for key, x in changes(one.log).items()} for one in logs]
    further = [joined_regressor([one[key] for one in added], starts) for key in added[0]]
    of_logs = [
        (i, *one)
        for i, log in enumerate(logs if nuisance else ())
        for one in log.nuisance_regressors()
    ]
    return Evidence(
        layout=logs[0].layout,
        t=np.concatenate([case.motion.t for case in cases]),
        log=np.repeat(np.arange(len(logs)), np.diff(starts)),
        table=table,
        keys=(*keys, *added[0]),
        X=(*map(regressor, keys), *further),
        Z=tuple(joined_regressor([one], starts, i) for i, one, *_ in of_logs),
        deviations=np.array([deviation for *_, deviation, _ in of_logs]),
        bias_of=tuple(key for *_, key in of_logs),
        reading_scale=scale,
        groups=frozenset(
            (name, target)
            for name, target in keys
            if target in known_effects()[name].group_targets(cases[0].robot.limbs)
        ),
    )


def table_of(
    case: LogUnderModel, chosen: Sequence[Effect], evaluation_channels: bool = True
) -> np.ndarray:
    """Residual table (M, W) of a case with `chosen` compensated.

    Without `evaluation_channels`, the channels that are only evaluated and never fitted are NaN.
    """
    return _Linear(case, chosen, evaluation_channels).table


def _reading_scale(layout: Layout, chosen: Sequence[Effect]) -> np.ndarray:
    """Factors (W,) of the columns that bring residuals back to the scale of the readings.

    Compensating a scale of a reading divides its residual by it, noise included, so that the
    largest scale would leave the least; with masses that shrink as well, next to nothing.
    """
    factor = np.ones(layout.width)
    for one in chosen:
        scales = one.readings if isinstance(one, Scale) else ()
        for column in chain.from_iterable(_UNIT_OF.get(reading, ()) for reading in scales):
            scaled = [f"{column}_{part}" for part in one.members(layout.limbs)]
            factor[np.isin(layout.names, scaled)] *= 1.0 + one.value
    return factor


_UNIT_OF = {"tau": ("torque", "command"), "gyro": ("gyro",), "accel": ("accel",)}
"""Reading -> names of the columns of the residual that its scale multiplies, without their part."""


class _Linear:
    """Residual of one log with the chosen effects compensated, and its derivatives.

    Attributes:
        table: residuals (M, W), each channel without the effects that are unseen by it, on the
            scale of the readings.
        reading_scale: factors (W,) of the columns that gave it this scale.
        parts: residuals of all channels with all of the chosen compensated.
        contacts_differ: whether the chosen change the contacts.
    """

    def __init__(
        self, case: LogUnderModel, chosen: Sequence[Effect], evaluation_channels: bool = True
    ):
        # One after the other, to start again from any of them.
        self.case, self.chosen = case, in_order(chosen)
        self.stages = [(case.log, case.robot)]
        for one in self.chosen:
            self.stages.append(compensate_all([one], *self.stages[-1]))
        self.log, self.robot = self.stages[-1]
        self.motion = self._motion(case.log, self.log, self.robot, case.motion)
        self.contacts_differ = self.motion is not case.motion and any(
            name.startswith("contact_") for name in changed_columns(case.log, self.log)
        )
        self.layout = layout_for(case.robot.limbs)
        every, known = tuple(self.layout.channels), channels()
        self.fitted = [name for name in every if not known[name].evaluation_only]
        self.names = every if evaluation_channels else self.fitted
        self.reading_scale = _reading_scale(self.layout, self.chosen)
        self.table, self._seeing_all = self._tables(self.chosen, self.names)
        self._known: dict[Key, Regressor] = {}

    def _motion(
        self, before: Log, log: Log, robot: Machine, motion: ReferenceMotion
    ) -> ReferenceMotion:
        """The reference motion of a log, given the `motion` of the log `before` a change."""
        if log is before or not any(
            name.startswith(("ref_", "contact_")) for name in changed_columns(before, log)
        ):
            return motion
        ground = {"level": motion.level, "normal_G": motion.normal_G}
        return replace(motion_under_model(log, robot, self.case.fixed), **ground)

    def _tables(
        self, effects: Sequence[Effect], names: Sequence[str]
    ) -> tuple[np.ndarray, ResidualTable]:
        """The table with other sizes of the chosen effects, and the residuals of those of the
        channels `names` that see all of them.
        """
        springs = self.case.springs
        seeing: dict[tuple[Sequence[Effect], ...], list[str]] = {(springs, tuple(effects)): []}
        for name in names:
            seen = (
                tuple(one for one in every if name not in one.traced.unseen_by)
                for every in (springs, effects)
            )
            seeing.setdefault(tuple(seen), []).append(name)
        log, robot = self._compensated(effects)
        motion = self._motion(self.case.log, log, robot, self.case.motion)
        direct = residual(log, robot, motion, seeing.pop((springs, tuple(effects))))
        table = direct.table.copy()
        for (declared, seen), of_these in seeing.items():
            columns = self.layout.of(*of_these)
            if declared == springs:
                log, robot = self._compensated(seen)
            else:
                assert self.case.unsprung is not None
                both = in_order([*declared, *seen])
                log, robot = compensate_all(both, self.case.unsprung, self.case.robot)
            others = residual(log, robot, motion, of_these)
            table[:, columns] = others.table[:, columns]
        return table * _reading_scale(self.layout, effects), direct

    def _compensated(self, effects: Sequence[Effect]) -> tuple[Log, Machine]:
        """The log and the model with these effects compensated, from where they first differ from
        the chosen.
        """
        pairs = zip(effects, self.chosen, strict=False)
        same = len([*takewhile(lambda pair: pair[0] is pair[1], pairs)])
        return compensate_all(effects[same:], *self.stages[same])

    @cached_property
    def parts(self) -> ResidualTable:
        direct = self._seeing_all
        others = [name for name in self.names if name not in direct.names]
        more, columns = filled(self.layout, direct.inputs, others), self.layout.of(*others)
        table = direct.table.copy()
        table[:, columns] = more[:, columns]
        return replace(direct, table=table, names=tuple(self.names))

    @cached_property
    def jacobians(self) -> ResidualJacobians:
        return ResidualJacobians(self.parts)

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
        """Derivative at zero, by the effect's chain rule or by a difference."""
        log, robot = compensate_all([effect(*key, step)], self.log, self.robot)
        if known_effects()[key[0]].traced.chain_rule == "readings":
            change = self._by_chain_rule(log, robot, step)
        else:
            change = self._by_difference(key, log, robot) / step
        factor = _reading_scale(self.layout, [effect(*key, step)])
        if not np.all(factor == 1.0):
            change = factor * change + (factor - 1.0) / step * self.parts.table
        one = self._to_reading_scale(self._where_it_shows(key, sparse(change, self.parts.table)))
        return Regressor(one.columns, -one.values)

    def by_columns(self, added: Mapping[str, np.ndarray]) -> Regressor:
        """Regressor of additions (N,) to columns of the log."""
        columns = {name: self.log.columns[name] + _CHANGE_STEP * x for name, x in added.items()}
        change = self._by_chain_rule(with_columns(self.log, columns), self.robot, _CHANGE_STEP)
        return self._to_reading_scale(sparse(change, self.parts.table))

    def _to_reading_scale(self, one: Regressor) -> Regressor:
        """A regressor of the residual as one of the table."""
        return Regressor(one.columns, one.values * self.reading_scale[one.columns])

    def _by_chain_rule(self, log: Log, robot: Machine, step: float) -> np.ndarray:
        """Change of the table (M, W) per unit, for a log that is `step` units away: by the chain
        rule, and by differences in the channels without one.
        """
        change = self.jacobians.wrt_readings(_change(self.log, log, self.motion, step))
        names = [name for name in self.layout.channels if name not in CHAINED_CHANNELS]
        columns = self.layout.of(*names)
        after = filled(self.layout, ResidualInputs(log, robot, self.motion), names)[:, columns]
        change[:, columns] += np.nan_to_num(after - self.parts.table[:, columns]) / step
        return change

    def _by_difference(self, key: Key, log: Log, robot: Machine) -> np.ndarray:
        """Change of the table (M, W) to this log and model, in the fitted channels that the effect
        may change.
        """
        inputs = ResidualInputs(log, robot, self._motion(self.log, log, robot, self.motion))
        same = unchanged_channels(self.robot, robot) if log is self.log else ()
        if known_effects()[key[0]].traced.chain_rule is not None and robot is not self.robot:
            # Such a step moves contact changes by less than a row: their times are kept.
            same = (*same, *(name for name in self.fitted if channels()[name].of_events))
            inputs = under_model(self.parts.inputs, robot)
        only = event_channels(key) or self.fitted
        again = [name for name in self.fitted if name in only and name not in same]
        return filled(self.layout, inputs, again) - self.parts.table

    def _derivative_at_value(self, key: Key) -> Regressor:
        """Derivative by central differences at the value of a chosen effect."""
        step = known_effects()[key[0]].traced_at(key[1]).step

        def table(more: float) -> np.ndarray:
            effects = [
                effect(*key, e.value + more) if (e.name, e.target) == key else e
                for e in self.chosen
            ]
            return self._tables(effects, self.fitted)[0]

        change = (table(-step) - table(step)) / (2 * step)
        return self._where_it_shows(key, sparse(change, self.parts.table))

    def _where_it_shows(self, key: Key, one: Regressor) -> Regressor:
        """Restrict the regressor of an effect to channels in which it shows.

        Of one that shows only in the times of events, this removes the changes of other channels,
        which come from stances with more or fewer samples, and events that were lost or matched to
        a neighbour.
        """
        kind, names, values = known_effects()[key[0]], event_channels(key), one.values
        shown = ~np.isin(one.columns, self.layout.of(*kind.traced.unseen_by))
        if names:
            shown = np.isin(one.columns, self.layout.of(*names))
            step = kind.traced_at(key[1]).step
            values = np.where(np.abs(step * values) < CHANGE_WINDOW, values, 0.0)
        return Regressor(one.columns[shown], values[:, shown])

    def nuisance_regressors(self) -> list[tuple[Regressor, float, Key | None]]:
        """Nuisance parameters of the log: regressor, prior standard deviation, and the candidate
        with the same meaning.
        """
        out: list[tuple[Regressor, float, Key | None]] = []
        parts, sensors = self.parts, Sensors()
        if not self.case.fixed and self.case.log.has("imu"):
            for axis, name in enumerate(AXES):
                ones = {axis: np.ones(len(parts.t))}
                for kind, turn_on, unit in (
                    ("gyro", sensors.gyro_turn_on, {"gyro": ones, "omega": ones}),
                    ("accel", sensors.accel_turn_on, {"accel": ones}),
                ):
                    one = sparse(self.jacobians.wrt_readings(unit), parts.table)
                    out.append((one, turn_on, (f"{kind}_bias", name)))
        for name in self.layout.channels:
            which = self.layout.of(name)
            for values in channels()[name].nuisance_regressors(parts.inputs):
                one = Regressor(which, np.where(np.isfinite(parts.table[:, which]), values, 0.0))
                out.append((self._to_reading_scale(one), np.inf, None))
        return out


def event_channels(key: Key) -> tuple[str, ...]:
    """Channels of an effect that shows only in the times of events; none for any other."""
    names = known_effects()[key[0]].traced_at(key[1]).channels
    of_events = all(name in channels() and channels()[name].of_events for name in names)
    return tuple(names) if of_events else ()


def _change(
    old: Log, new: Log, motion: ReferenceMotion, step: float
) -> dict[str, dict[int, np.ndarray]]:
    """Change of each stream per unit of an effect: stream -> index -> means over bins (M,).

    Args:
        old: log before the change.
        new: log after it.
        motion: reference motion of the log, with its bins.
        step: size of the change, in the effect's unit.
    """
    change: dict[str, dict[int, np.ndarray]] = {}
    mean, logged = bin_mean(motion), old.has("dq")
    for name in changed_columns(old, new):
        stream, _, what = name.partition("_")
        parts = AXES if stream in ("gyro", "accel") else old.joints
        if what not in parts:
            continue
        place, x = parts.index(what), new.columns[name] - old.columns[name]
        rows, rates = {stream: x}, None
        if stream == "gyro":
            rows["omega"] = at_rows(x)
        elif stream == "q":
            rows["q_step"] = at_torques(x, motion)
            if motion.rates_of_angles or not logged:
                # Joint rates that were not logged are derived from the angles.
                rates = derivative(old.t, x[:, None], JOINT_WINDOW, causal=False)[:, 0]
                rows |= {} if logged else {"dq": rates}
        elif stream == "dq" and not motion.rates_of_angles:
            rates = x
        means = {kind: mean(values) for kind, values in rows.items()}
        if rates is not None:
            means["dq_step"] = mean(at_torques(rates, motion))
            means["ddq"] = mean_rate_of_change(rates, old.t, motion)
        for kind, values in means.items():
            change.setdefault(kind, {})[place] = values / step
    return change


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


def joined_regressor(parts: Sequence[Regressor], starts: np.ndarray, first: int = 0) -> Regressor:
    """Concatenate the regressors of several logs, from the log `first` on; zero in the others."""
    if len(starts) == 2:
        return parts[0]
    columns = np.unique(np.concatenate([p.columns for p in parts]))
    values = np.zeros((starts[-1], len(columns)))
    for part, start, end in zip(parts, starts[first:], starts[first + 1 :], strict=False):
        values[start:end, np.searchsorted(columns, part.columns)] = part.values
    return Regressor(columns, values)
