"""The form of what no effect explains: which simple regressors go with the rest of a residual."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.candidates import Case
from models.masking import GROUPS, Trust
from models.residual import COLUMNS
from sim.log import joint_velocity

AT_MOST = 3
"""Regressors named for one column."""
LEAST = 0.05
"""Share of a column's rest that a regressor must explain on unseen blocks to be named."""
_NAMES = ("gyro", "accel", *(f"leg_{leg}" for leg in ("FL", "FR", "RL", "RR")))


@dataclass(frozen=True)
class Remainder:
    """One column of a channel, regressors that go with its rest, and the share they explain."""

    channel: str
    column: str
    regressors: tuple[str, ...]
    share: float


def form(
    cases: Sequence[Case],
    left: np.ndarray,
    trusted: Trust,
    channels: Sequence[str],
    seen: np.ndarray,
    unseen: np.ndarray,
) -> tuple[Remainder, ...]:
    """What goes with the rest `left` (M, 18) in these channels, the strongest first.

    Forward selection of regressors on the bins `seen` (M,), shares on the bins `unseen` (M,).
    """
    names, values = library(cases)
    found = []
    for channel in channels:
        for column in range(*COLUMNS[channel].indices(18)):
            one = _column(values, left[:, column], trusted.weight[:, column], seen, unseen)
            if one is not None:
                chosen, share = one
                found.append(
                    Remainder(channel, _label(column), tuple(names[i] for i in chosen), share)
                )
    return tuple(sorted(found, key=lambda r: -r.share))


def library(cases: Sequence[Case]) -> tuple[tuple[str, ...], np.ndarray]:
    """Names and values (M, R) of the regressors: bin means, each of unit spread."""
    tables = []
    names: list[str] = []
    for case in cases:
        log, first = case.log, case.frame.first
        count = np.diff(np.append(first, len(log.t)))[:, None]
        columns = {"time": log.t[:, None]}
        if log.has("imu"):
            columns |= {"rate": log.gyro, "force": log.accel}
        columns["velocity"] = case.frame.v_I
        columns["upward"] = case.frame.up_I
        if log.has("q"):
            columns |= {"angle": log.q, "speed": joint_velocity(log)}
        if log.has("tau"):
            columns["torque"] = log.tau
        if log.has("contact"):
            columns["stance"] = log.contact.astype(float)
        names = [
            name if x.shape[1] == 1 else f"{name}_{suffix}"
            for name, x in columns.items()
            for suffix in ("xyz" if x.shape[1] == 3 else log.joints if x.shape[1] == 12 else
                           ("FL", "FR", "RL", "RR"))[: x.shape[1]]
        ]  # fmt: skip
        rows = np.column_stack(list(columns.values()))
        tables.append(np.add.reduceat(rows, first, axis=0) / count)
    values = np.concatenate(tables)
    spread = values.std(axis=0)
    return tuple(names), (values - values.mean(axis=0)) / np.where(spread > 1e-12, spread, 1.0)


def _column(
    values: np.ndarray, y: np.ndarray, weight: np.ndarray, seen: np.ndarray, unseen: np.ndarray
) -> tuple[list[int], float] | None:
    there = np.isfinite(y) & (weight > 0)
    fit, check = there & seen, there & unseen
    if fit.sum() < 50 or check.sum() < 50:
        return None
    root = np.sqrt(weight)[:, None]
    ones = np.ones((len(y), 1))
    chosen: list[int] = []
    share = 0.0
    while len(chosen) < AT_MOST:
        A = np.hstack([ones, values[:, chosen]]) * root
        base = _solve(A, y * root[:, 0], fit)
        rest = np.where(there, np.nan_to_num(y) * root[:, 0] - A @ base, 0.0)
        X = values * root
        pull = np.abs(X[fit].T @ rest[fit]) / np.maximum(np.linalg.norm(X[fit], axis=0), 1e-12)
        pull[chosen] = 0.0
        best = int(np.argmax(pull))
        A = np.hstack([ones, values[:, [*chosen, best]]]) * root
        after = y[check] * root[check, 0] - A[check] @ _solve(A, y * root[:, 0], fit)
        plain = (y[check] - np.average(y[check], weights=weight[check])) * root[check, 0]
        gained = 1.0 - float(after @ after) / max(float(plain @ plain), 1e-300)
        if gained < share + LEAST:
            break
        chosen, share = [*chosen, best], gained
    return (chosen, share) if chosen else None


def _solve(A: np.ndarray, y: np.ndarray, rows: np.ndarray) -> np.ndarray:
    return np.linalg.lstsq(A[rows], y[rows], rcond=1e-10)[0]


def _label(column: int) -> str:
    group = next(i for i, g in enumerate(GROUPS) if g.start <= column < g.stop)
    return f"{_NAMES[group]}_{'xyz'[column - GROUPS[group].start]}"
