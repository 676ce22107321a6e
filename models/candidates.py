"""How the residual of a log answers to each candidate effect: linear regressors by its size."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.residual import Frame, residual
from sim.effects import CATALOGUE, Effect, effect, explain_all
from sim.log import Log
from sim.robot import Robot

Key = tuple[str, str]
"""A candidate: effect name and target."""
BIAS_STEP = 1e-3  # rad/s


@dataclass(frozen=True)
class Evidence:
    """Residuals of M bins and what would explain them: table = X sizes + Z biases + noise.

    t (M,) s; log (M,) which log a bin is from; table (M, 18) as `Residual.table`; X (M, 18, C) by
    the size of each of `keys`; Z (M, 18, 6) by the turn-on biases of gyro [rad/s] and accelerometer
    [m/s^2]. A bin's missing entries are NaN in the table and zero in X and Z.
    """

    t: np.ndarray
    log: np.ndarray
    table: np.ndarray
    keys: tuple[Key, ...]
    X: np.ndarray
    Z: np.ndarray

    def rows(self, which: np.ndarray) -> "Evidence":
        """The evidence of some bins: mask (M,) or indices."""
        return Evidence(
            self.t[which], self.log[which], self.table[which], self.keys, self.X[which],
            self.Z[which],
        )  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A log, the declared model it is held against, and its reference."""

    log: Log
    robot: Robot
    frame: Frame


def all_keys(log: Log) -> tuple[Key, ...]:
    """Every candidate that a model can know of and whose channels the log has."""
    there = {"imu_gyro": log.has("imu"), "imu_accel": log.has("imu")}
    there["leg_velocity"] = log.has("q") and log.has("contact")
    # What turns the IMU touches leg_velocity too, but it is the IMU that must be there.
    return tuple(
        (kind.name, target)
        for kind in CATALOGUE.values()
        if kind.is_explained() and there[kind.channels[0]]
        for target in kind.targets
    )


def linearise(
    cases: Sequence[Case], chosen: Sequence[Effect], keys: Sequence[Key], central: bool = False
) -> Evidence:
    """Residuals once `chosen` are explained, and their derivatives by the sizes of `keys`.

    A key among the chosen is varied about its value, any other about zero. With `central`
    differences instead of forward ones, for the last refinement.
    """
    parts = [_linearise(case, i, chosen, tuple(keys), central) for i, case in enumerate(cases)]
    joined = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("t", "log", "table", "X", "Z")
    }
    return Evidence(keys=tuple(keys), **joined)


def table_of(case: Case, chosen: Sequence[Effect]) -> np.ndarray:
    """Residual table (M, 18) of a case once `chosen` are explained."""
    log, robot = explain_all(chosen, case.log, case.robot)
    return residual(log, robot, case.frame).table


def _linearise(
    case: Case, number: int, chosen: Sequence[Effect], keys: tuple[Key, ...], central: bool
) -> Evidence:
    table = table_of(case, chosen)
    X = np.zeros((*table.shape, len(keys)))
    for i, key in enumerate(keys):
        step = CATALOGUE[key[0]].step
        ahead = table_of(case, _moved(chosen, key, step))
        behind = table_of(case, _moved(chosen, key, -step)) if central else table
        X[:, :, i] = (behind - ahead) / (2 * step if central else step)
    Z = np.zeros((*table.shape, 6))
    Z[:, range(6), range(6)] = 1.0
    if case.log.has("imu"):
        log, robot = explain_all(chosen, case.log, case.robot)
        for axis, name in enumerate("xyz"):
            frame = log.frame.copy(deep=False)
            frame[f"gyro_{name}"] = frame[f"gyro_{name}"] - BIAS_STEP
            shifted = residual(replace(log, frame=frame), robot, case.frame).table
            Z[:, :, axis] = (table - shifted) / BIAS_STEP
    there = np.isfinite(table)[:, :, None]
    return Evidence(
        t=case.frame.t,
        log=np.full(len(table), number),
        table=table,
        keys=keys,
        X=np.where(there, X, 0.0),
        Z=np.where(there, Z, 0.0),
    )


def _moved(chosen: Sequence[Effect], key: Key, step: float) -> list[Effect]:
    effects = list(chosen)
    for i, one in enumerate(effects):
        if (one.name, one.target) == key:
            effects[i] = effect(*key, one.value + step)
            return effects
    return [*effects, effect(*key, step)]
