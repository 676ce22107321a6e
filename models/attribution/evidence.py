"""How the residual of a log answers to each candidate effect: linear regressors by its size."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from surefoot.models.attribution.run_offsets import deviations, of_each_run
from surefoot.models.attribution.settings import DEFAULT, TraceSettings
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
    motion_under_model,
    residual,
    with_ground,
)
from surefoot.sim.common.sources import code_digest
from surefoot.sim.effects import Effect, compensate_all, effect, known_effects
from surefoot.sim.effects.base import changed_columns, with_columns
from surefoot.sim.log import Log
from surefoot.sim.log.derived import JOINT_WINDOW, derivative
from surefoot.sim.robot import Robot
from surefoot.sim.robot.fixed_base import Machine
from surefoot.sim.sensors.streams import Sensors

Key = tuple[str, str]
"""A candidate: effect name and target."""


FEW_BINS = 0.02
"""Share of the numbers of a table that may come and go before its derivatives are taken anew."""


@dataclass(frozen=True)
class Evidence:
    """Residuals of M bins and what would explain them: table = X sizes + Z biases + noise.

    t (M,) s; log (M,) which log a bin is from; table (M, W), its columns as `layout` says, NaN
    where a bin has none; X: by the size of each of `keys`; Z: by what may be free in each log, the
    turn-on biases of its IMU, up to +-limits (B,), and the plane that it stands on. `stands_for`:
    of each of Z, the candidate that takes its place without a limit; `comes_with`: of each, the
    candidate that it is free with, since the size of that one may differ from log to log. groups:
    the candidates whose regressor is the sum of others'.
    """

    layout: Layout
    t: np.ndarray
    log: np.ndarray
    table: np.ndarray
    keys: tuple[Key, ...]
    X: tuple[Regressor, ...]
    Z: tuple[Regressor, ...]
    limits: np.ndarray
    stands_for: tuple[Key | None, ...]
    comes_with: tuple[Key | None, ...] = ()
    settings: TraceSettings = DEFAULT
    groups: frozenset[Key] = frozenset()

    @cached_property
    def single(self) -> np.ndarray:
        """Which of the candidates and the free parts (C + B,) are no sum of others."""
        along = self.comes_with or (None,) * len(self.Z)
        return np.array([key not in self.groups for key in (*self.keys, *along)])

    def only(self, keys: Sequence[Key]) -> "Evidence":
        """The evidence with no other candidates than these."""
        X = tuple(self.X[self.keys.index(key)] for key in keys)
        return replace(self, keys=tuple(keys), X=X)


@dataclass(frozen=True)
class LogUnderModel:
    """A log, the declared model it is held against, and its reference."""

    log: Log
    robot: Machine
    frame: ReferenceMotion
    fixed: bool = False
    settings: TraceSettings = DEFAULT


def log_under_model(log: Log, robot: Machine, settings: TraceSettings = DEFAULT) -> LogUnderModel:
    """The log held against the robot. Without a reference a base is taken to be fixed whose log
    shows neither a foot on the ground nor a turn of the body."""
    stands = log.has("contact") and log.contact.any()
    turns = log.has("imu") and np.sqrt(np.mean(np.square(log.gyro))) > settings.held_still
    hung = not log.has("reference") and not (stands or turns) and log.has("q")
    fixed = not isinstance(robot, Robot) or hung
    log = log.keeping()
    frame = motion_under_model(log, robot, fixed)
    if fixed and log.has("tau") and angles_are_quieter(log, frame):
        frame = replace(frame, rates_of_angles=True)
    return LogUnderModel(log, robot, with_ground(frame, log, robot), fixed, settings)


def channels_of(case: LogUnderModel) -> tuple[str, ...]:
    """The channels that a log can fill at all."""
    layout = layout_for(case.robot.limbs)
    return tuple(
        name
        for name, channel in channels().items()
        if name in layout and channel.fills(case.log, case.fixed, case.frame.level)
    )


def all_keys(case: LogUnderModel) -> tuple[Key, ...]:
    """Every candidate that a model can know of and whose channels the log has."""
    there, keys = {*channels_of(case)}, []
    for kind in known_effects().usable()[0].values():
        lacks = case.fixed and "reference" in kind.needs
        if not kind.is_compensated() or lacks or not kind.is_compensated_on(case.log):
            continue
        keys += [
            (kind.name, target)
            for target in kind.targets_on(case.robot.limbs)
            if there & {*kind.channels_of(target)}
            and not (isinstance(case.robot, Robot) and kind.is_another(target, case.robot))
        ]
    return tuple(keys)


def candidates_code() -> str:
    """Digest of the code of every effect and residual channel, users' own too."""
    kinds = [*known_effects().values(), *map(type, channels().values())]
    return code_digest(*kinds)


def linearise(
    cases: Sequence[LogUnderModel],
    chosen: Sequence[Effect],
    keys: Sequence[Key],
    before: Evidence | None = None,
    judged: bool = True,
) -> Evidence:
    """Residuals once `chosen` are explained, and their derivatives by the sizes of `keys`.

    A key among the chosen is varied about its value, by central differences of the true residual;
    any other about zero, by the chain rule. Derivatives by the latter change by no more than a
    chosen effect's own share of what is read: those of an evidence `before` may serve again.

    Args:
        cases: the logs under the declared model.
        chosen: effects that are explained.
        keys: of the candidates.
        before: an evidence whose derivatives may serve again.
        judged: whether channels that only judge have numbers, as no fit needs them.
    """
    parts = [_Linear(case, chosen, judged) for case in cases]
    tables = [p.parts.table for p in parts]
    starts = np.cumsum([0] + [len(table) for table in tables])
    if before is not None and _same_bins(before, np.concatenate(tables)):
        own = {(e.name, e.target) for e in chosen}
        if any(part.contacts_differ for part in parts):
            # Which feet share the weight is another, even where the same bins are inside a stance.
            own |= {key for key in before.keys if known_effects()[key[0]].takes_loads}
        X = tuple(
            joined_regressor([p.regressor(key) for p in parts], starts) if key in own else one
            for key, one in zip(before.keys, before.X, strict=True)
        )
        return replace(before, table=np.concatenate(tables), X=X)
    X = tuple(joined_regressor([p.regressor(key) for p in parts], starts) for key in keys)
    Z, limits, stands_for = [], [], []
    for i, part in enumerate(parts):
        for one, limit, key in part.free():
            whole = np.zeros((starts[-1], len(one.columns)))
            whole[starts[i] : starts[i + 1]] = one.values
            Z.append(Regressor(one.columns, whole))
            limits.append(limit)
            stands_for.append(key)
    log = np.repeat(np.arange(len(parts)), np.diff(starts))
    comes_with: list[Key | None] = [None] * len(Z)
    for key, one in zip(keys, X, strict=True):
        if of_each_run(key[0]):
            own = deviations(one, log)
            Z += own
            limits += [np.inf] * len(own)
            stands_for += [None] * len(own)
            comes_with += [key] * len(own)
    return Evidence(
        layout=parts[0].parts.layout,
        t=np.concatenate([p.parts.t for p in parts]),
        log=log,
        table=np.concatenate(tables),
        keys=tuple(keys),
        X=X,
        Z=tuple(Z),
        limits=np.array(limits),
        stands_for=tuple(stands_for),
        comes_with=tuple(comes_with),
        settings=cases[0].settings,
        groups=frozenset(
            (name, target)
            for name, target in keys
            if target in known_effects()[name].group_targets(cases[0].robot.limbs)
        ),
    )


def wrt_columns(
    case: LogUnderModel,
    chosen: Sequence[Effect],
    altered: Callable[[Log], Sequence[Mapping[str, np.ndarray]]],
) -> list[Regressor]:
    """What changes of a log's columns, each (N,), add to its table once `chosen` are explained."""
    linear = _Linear(case, chosen)
    return [linear.by_columns(columns) for columns in altered(linear.log)]


def table_of(case: LogUnderModel, chosen: Sequence[Effect], judged: bool = True) -> np.ndarray:
    """Residual table (M, W) of a case once `chosen` are explained; channels that only judge have
    no numbers in it where nothing is `judged`."""
    return _parts(case, chosen, judged)[2].table


def _parts(
    case: LogUnderModel, chosen: Sequence[Effect], judged: bool = True
) -> tuple[Log, Machine, ResidualTable, ReferenceMotion]:
    log, robot = compensate_all(chosen, case.log, case.robot)
    frame = case.frame
    if log is not case.log and _moves_frame(changed_columns(case.log, log)):
        frame = replace(motion_under_model(log, robot, case.fixed), level=case.frame.level)
    names = [name for name, channel in channels().items() if judged or not channel.judges]
    return log, robot, residual(log, robot, frame, names), frame


class _Linear:
    """One log's residual with the chosen effects explained, and its derivatives."""

    def __init__(self, case: LogUnderModel, chosen: Sequence[Effect], judged: bool = True):
        self.case, self.chosen, self.judged = case, list(chosen), judged
        self.log, self.robot, self.parts, self.frame = _parts(case, chosen, judged)
        self.joints = self.log.joints
        self.contacts_differ = self.frame is not case.frame and any(
            name.startswith("contact_") for name in changed_columns(case.log, self.log)
        )
        self._known: dict[Key, Regressor] = {}

    @cached_property
    def jacobians(self) -> ResidualJacobians:
        return residual_jacobians(self.parts, self.robot)

    def regressor(self, key: Key) -> Regressor:
        """What one unit of the effect `key` adds to the table."""
        if key not in self._known:
            self._known[key] = self._regressor(key)
        return self._known[key]

    def _regressor(self, key: Key) -> Regressor:
        if any((e.name, e.target) == key for e in self.chosen):
            return self._about_its_value(key)
        kind = known_effects()[key[0]]
        members = kind.members_of(key[1], self.robot.limbs)
        if members != (key[1],):
            # One size for all: to first order each adds what it would alone.
            return summed_regressor([self.regressor((key[0], member)) for member in members])
        sizes = kind.starts_on(key[1], self.log)
        tried = [self._from_zero(key, size) for size in sizes]
        if len(tried) == 1:
            return tried[0]
        # Each start for sizes of its own sign.
        shares = [explained_share(one, self.parts.table) for one in tried]
        return tried[int(np.argmax(np.sign(sizes) * shares))]

    def _from_zero(self, key: Key, step: float) -> Regressor:
        """By a difference of the residual, or by the chain rule that the effect declares."""
        log, robot = compensate_all([effect(*key, step)], self.log, self.robot)
        rule = known_effects()[key[0]].chain_rule
        if rule == "readings":
            change = self._by_chain_rule(log, step) + self._of_others(log, robot, step)
        elif rule is not None:
            change = wrt_robot(self.parts, self.robot, robot, step)
        else:
            change = self._by_difference(log, robot, step)
        one = self._own(key, sparse(change, self.parts.table))
        return Regressor(one.columns, -one.values)

    def by_columns(self, added: Mapping[str, np.ndarray]) -> Regressor:
        """What these additions (N,) to the readings add to the table."""
        columns = {name: self.log.columns[name] + x for name, x in added.items()}
        change = self._by_chain_rule(with_columns(self.log, columns), 1.0)
        share = self.case.settings.small_change
        small = {n: self.log.columns[n] + share * x for n, x in added.items()}
        others = self._of_others(with_columns(self.log, small), self.robot, share)
        return sparse(change + others, self.parts.table)

    def _by_chain_rule(self, log: Log, step: float) -> np.ndarray:
        """Change (M, W) of the table, per unit, with the readings of `log`, `step` units away."""
        change = _change(self.log, log, self.joints, self.frame, step)
        return wrt_readings(self.parts, self.jacobians, change)

    def _of_others(self, log: Log, robot: Machine, step: float) -> np.ndarray:
        """The same (M, W) in the channels that the chain rule does not know, by a difference."""
        layout, table = self.parts.layout, self.parts.table
        inputs, change = ResidualInputs(log, robot, self.frame), np.zeros(table.shape)
        for name, columns in layout.channels.items():
            if not channels()[name].chained and channels()[name].answers(log, self.frame):
                values = channels()[name].residual(inputs)
                if values is not None:
                    change[:, columns] = np.nan_to_num(values - table[:, columns]) / step
        return change

    def _about_its_value(self, key: Key) -> Regressor:
        step = known_effects()[key[0]].step_of(key[1])
        ahead, behind = (
            table_of(self.case, _moved(self.chosen, key, s), self.judged) for s in (step, -step)
        )
        return self._own(key, sparse((behind - ahead) / (2 * step), self.parts.table))

    def _own(self, key: Key, one: Regressor) -> Regressor:
        """The regressor of an effect that shows only in the times of events, without what more or
        fewer samples of a stance do to other channels, and without events that were lost or taken
        for their neighbours."""
        names = known_effects()[key[0]].channels_of(key[1])
        if not all(name in channels() and channels()[name].of_events for name in names):
            return one
        own = np.isin(one.columns, self.parts.layout.of(*names))
        values, step = one.values[:, own], known_effects()[key[0]].step_of(key[1])
        return Regressor(
            one.columns[own], np.where(np.abs(step * values) < CHANGE_WINDOW, values, 0.0)
        )

    def _by_difference(self, log: Log, robot: Machine, step: float) -> np.ndarray:
        frame, same = self.frame, ()
        if log is self.log:
            same = unchanged_channels(self.robot, robot)
        elif _moves_frame(changed_columns(self.log, log)):
            frame = replace(motion_under_model(log, robot, self.case.fixed), level=frame.level)
        again = [name for name in self.parts.names if name not in same]
        return (residual(log, robot, frame, again).table - self.parts.table) / step

    def free(self) -> list[tuple[Regressor, float, Key | None]]:
        """What may be free in a log, its limit, and the candidate that stands for it."""
        out: list[tuple[Regressor, float, Key | None]] = []
        parts, sensors = self.parts, Sensors()
        if not self.case.fixed and self.case.log.has("imu"):
            deviations = {"gyro": sensors.gyro_turn_on, "accel": sensors.accel_turn_on}
            most = self.case.settings.turn_on_limit
            for axis, name in enumerate("xyz"):
                for kind, turn_on in deviations.items():
                    ones = {axis: np.ones(len(parts.t))}
                    unit = {kind: ones} | ({"omega": ones} if kind == "gyro" else {})
                    one = sparse(wrt_readings(parts, self.jacobians, unit), parts.table)
                    out.append((one, most * turn_on, (f"{kind}_bias", name)))
        for name, columns in parts.layout.channels.items():
            for values in channels()[name].free(parts.inputs):
                which = parts.layout.of(name)
                there = np.isfinite(parts.table[:, columns])
                out.append((Regressor(which, there * values), np.inf, None))
        return out


def _moves_frame(columns: Sequence[str]) -> bool:
    return any(name.startswith(("ref_", "contact_")) for name in columns)


def _moved(chosen: Sequence[Effect], key: Key, step: float) -> list[Effect]:
    return [effect(*key, e.value + step) if (e.name, e.target) == key else e for e in chosen]


def _change(
    old: Log, new: Log, joints: Sequence[str], frame: ReferenceMotion, step: float
) -> dict[str, dict[int, np.ndarray]]:
    """Change of each stream for one unit of an effect: stream -> place -> means over bins (M,).

    Args:
        old: log before the change.
        new: log after it; its attrs name the columns that changed.
        joints: names, in the order of the columns.
        frame: reference motion of the log, with its bins.
        step: size of the change, in the effect's unit.
    """
    change: dict[str, dict[int, np.ndarray]] = {}
    mean = bin_mean(frame)
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
        elif stream == "q" or (stream == "dq" and not frame.rates_of_angles):
            means |= _of_joint(stream, rows, old.t, frame)
        if stream == "q" and (frame.rates_of_angles or not old.has("dq")):
            # Rates that were not logged are those of the angles.
            rates = derivative(old.t, rows[:, None], JOINT_WINDOW, causal=False)[:, 0]
            means |= _of_joint("dq", rates, old.t, frame)
            if not old.has("dq"):
                means["dq"] = mean(rates)
        for kind, values in means.items():
            change.setdefault(kind, {})[place] = values / step
    return change


def _of_joint(
    stream: str, rows: np.ndarray, t: np.ndarray, frame: ReferenceMotion
) -> dict[str, np.ndarray]:
    """Means over the times of torques of a change of angle or rate (N,), and how fast a rate
    changes."""
    means = {f"{stream}_step": bin_mean(frame)(at_torques(rows, frame))}
    if stream == "dq":
        means["ddq"] = mean_rate_of_change(rows, t, frame)
    return means


def _same_bins(before: Evidence, table: np.ndarray) -> bool:
    """Whether a table (M, W) has numbers where the evidence has, of the channels that are fitted.

    Other contacts are other stances; a bin at the end of a few of them is none.
    """
    fitted = before.layout.fitted
    there, now = np.isfinite(before.table[:, fitted]), np.isfinite(table[:, fitted])
    if there.shape != now.shape:
        return False
    return int(np.count_nonzero(there != now)) <= FEW_BINS * int(np.count_nonzero(there))


def summed_regressor(parts: Sequence[Regressor]) -> Regressor:
    """The sum of some regressors of one log."""
    columns = np.unique(np.concatenate([p.columns for p in parts]))
    values = np.zeros((len(parts[0].values), len(columns)))
    for part in parts:
        values[:, np.searchsorted(columns, part.columns)] += part.values
    return Regressor(columns, values)


def joined_regressor(parts: Sequence[Regressor], starts: np.ndarray) -> Regressor:
    """One regressor over several logs."""
    if len(parts) == 1:
        return parts[0]
    columns = np.unique(np.concatenate([p.columns for p in parts]))
    values = np.zeros((starts[-1], len(columns)))
    for i, part in enumerate(parts):
        values[starts[i] : starts[i + 1], np.searchsorted(columns, part.columns)] = part.values
    return Regressor(columns, values)
