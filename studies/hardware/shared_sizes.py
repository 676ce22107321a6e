"""Calibration of one chain of joints from several runs: shared sizes, variation between runs,
zeros.

In the torque balance in windows (`impulses`), the residual of run r and log l is linear in C sizes:

    rest = X (c + u_r) + Z z_l + noise,  c ~ N(0, a^2 D),  u_r ~ N(0, b^2 D),  z_l ~ N(0, ZERO^2)

D scales all terms to the same torque. The deviation of the sizes from the published ones (a), the
variation between runs of an unchanged machine (b), and each joint's noise maximise the likelihood
of all rows (a mixed model: Laird and Ware, Biometrics 38, 1982). Errors of the model, which a fit
to a single run would attribute to its sizes, are thus a part of the variation between runs.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.linalg import block_diag, cho_factor, cho_solve
from scipy.optimize import minimize

from studies.hardware.drives import between, rms
from studies.hardware.impulses import (
    UNITS_OF_TERMS,
    SizeKey,
    WindowRows,
    as_published,
)
from surefoot.extend import Modelled
from surefoot.scenarios.reporting import AFTER, BEFORE, INK, legend_below, new_figure, set_title

ZERO = 0.03
"""Standard deviation of a zero that was set by hand, with the machine hanging or by marks [rad]."""
Runs = Mapping[str, Sequence[WindowRows]]
"""Windows of logs, by run; the pieces of a divided run belong together."""


@dataclass(frozen=True)
class Calibration:
    """Sizes shared by several runs.

    Attributes:
        keys: of the C sizes.
        value: (C,).
        covariance: (C, C).
        apart: standard deviation between runs (C,).
        noise: of each joint (J,) [N m].
    """

    keys: tuple[SizeKey, ...]
    value: np.ndarray
    covariance: np.ndarray
    apart: np.ndarray
    noise: np.ndarray

    def left(self, logs: Sequence[WindowRows]) -> np.ndarray:
        """Residual torque (R,) of a run with these sizes, joint after joint."""
        return stacked_rest(logs) - stacked_terms(logs, self.keys) @ self.value

    def zeroed(self, logs: Sequence[WindowRows], rest: np.ndarray) -> np.ndarray:
        """The part of a residual torque (R,) of a run that zeros of its logs do not explain."""
        noise = np.concatenate([np.tile(self.noise**2, len(log.t)) for log in logs])
        return noise * np.linalg.solve(own_spread(logs, self.noise), rest)

    def spread(self, logs: Sequence[WindowRows]) -> np.ndarray:
        """Covariance (R, R) of the residual of an unchanged run."""
        X = stacked_terms(logs, self.keys)
        return own_spread(logs, self.noise) + X @ (self.covariance + np.diag(self.apart**2)) @ X.T


def shared_calibration(runs: Runs) -> Calibration:
    """Estimate the sizes that these runs share, from all of their rows."""
    keys = tuple(next(iter(runs.values()))[0].terms)
    y = np.concatenate([stacked_rest(own) for own in runs.values()])
    X = np.concatenate([stacked_terms(own, keys) for own in runs.values()])
    rows = [len(stacked_rest(own)) for own in runs.values()]
    same = np.repeat(np.arange(len(runs)), rows)
    same = same[:, None] == same
    joints = len(next(iter(runs.values()))[0].joints)
    scale = y.reshape(-1, joints).std(axis=0)
    # Scaled such that one standard deviation of a size has the RMS residual of the declared model.
    D = 1.0 / np.mean((X / np.tile(scale, len(y) // joints)[:, None]) ** 2, axis=0)
    shared = (X * D) @ X.T

    def covariance(deviations: np.ndarray) -> np.ndarray:
        a, b, *noise = deviations
        own = block_diag(*(own_spread(logs, np.array(noise)) for logs in runs.values()))
        return shared * (a**2 + b**2 * same) + own

    def unlikely(logarithms: np.ndarray) -> float:
        factor = cho_factor(covariance(np.exp(logarithms)), lower=True)
        return float(2.0 * np.log(np.diag(factor[0])).sum() + y @ cho_solve(factor, y))

    start = np.log([0.5, 0.1, *(0.3 * scale)])
    bounds = [(x - 7.0, x + 3.0) for x in start]
    best = np.exp(minimize(unlikely, start, method="L-BFGS-B", bounds=bounds).x)
    factor = cho_factor(covariance(best), lower=True)
    a, b, *noise = best
    known = X * D * a**2
    value = known.T @ cho_solve(factor, y)
    uncertain = np.diag(D * a**2) - known.T @ cho_solve(factor, known)
    return Calibration(keys, value, uncertain, b * np.sqrt(D), np.array(noise))


def stacked_rest(logs: Sequence[WindowRows]) -> np.ndarray:
    """Residual torque (R,) of the declared model in the logs of a run."""
    return np.concatenate([log.rest.ravel() for log in logs])


def stacked_terms(logs: Sequence[WindowRows], keys: Sequence[SizeKey]) -> np.ndarray:
    """The terms (R, C) of the logs of a run."""
    return np.concatenate(
        [np.column_stack([log.terms[key].ravel() for key in keys]) for log in logs]
    )


def own_spread(logs: Sequence[WindowRows], noise: np.ndarray) -> np.ndarray:
    """Covariance (R, R) of a run's rows from their noise (J,) and the zeros of each log."""
    parts = []
    for log in logs:
        Z = log.zeros.reshape(len(log.zeros), -1)
        parts.append(ZERO**2 * Z.T @ Z + np.diag(np.tile(noise**2, len(log.t))))
    return np.asarray(block_diag(*parts))


@dataclass(frozen=True)
class HeldOutRun:
    """A run, evaluated with the sizes of the others: its windows, and its residual torque (N, J) [N
    m] with the declared model, with its own zeros fitted, and with the others' sizes as well.
    """

    name: str
    others: Calibration
    rows: tuple[WindowRows, ...]
    before: np.ndarray
    zeroed: np.ndarray
    after: np.ndarray


def runs_left_out(runs: Runs) -> tuple[HeldOutRun, ...]:
    """Evaluate each run with the sizes shared by the others, and its own zeros."""
    done = []
    for name, own in runs.items():
        others = shared_calibration({k: v for k, v in runs.items() if k != name})
        before = stacked_rest(own)
        zeroed, after = (others.zeroed(own, x) for x in (before, others.left(own)))
        parts = (x.reshape(-1, len(own[0].joints)) for x in (before, zeroed, after))
        done.append(HeldOutRun(name, others, tuple(own), *parts))
    return tuple(done)


def left_out_table(done: Sequence[HeldOutRun]) -> pd.DataFrame:
    """One row for each run and joint: root mean square of the residual torque, and of that to which
    the zeros were fitted.
    """
    return pd.DataFrame(
        {
            "run held out": one.name,
            "joint": joint,
            "declared model [N m]": f"{rms(one.before[:, j]):.3f}",
            "with zeros of its own [N m]": f"{rms(one.zeroed[:, j]):.3f}",
            "and the others' sizes [N m]": f"{rms(one.after[:, j]):.3f}",
            "left [% of zeros alone]": f"{100 * rms(one.after[:, j]) / rms(one.zeroed[:, j]):.0f}",
        }
        for one in done
        for j, joint in enumerate(one.rows[0].joints)
    )


def shared_sizes_table(whole: Calibration, machine: Modelled) -> pd.DataFrame:
    """One row for each size: published value, correction, and variation between runs."""
    rows = []
    for k, (name, joint) in enumerate(whole.keys):
        value, twice = whole.value[k], 1.96 * np.sqrt(whole.covariance[k, k])
        of_file = as_published(machine, joint).get(name)
        rows.append(
            {
                "joint or its link": joint,
                "size": name,
                "unit": UNITS_OF_TERMS[name],
                "published": "–" if of_file is None else f"{of_file:.4f}",
                "beyond it (95 % interval)": between(value, (value - twice, value + twice), 4),
                "runs differ by (standard deviation)": f"{whole.apart[k]:.4f}",
            }
        )
    return pd.DataFrame(rows)


def lengths_table(calibrations: Mapping[float, Calibration]) -> pd.DataFrame:
    """One row for each size: its estimate with windows of several lengths [s], and twice its
    standard deviation.
    """
    keys = next(iter(calibrations.values())).keys
    rows = []
    for k, (name, joint) in enumerate(keys):
        row = {"joint or its link": joint, "size": name, "unit": UNITS_OF_TERMS[name]}
        for length, one in calibrations.items():
            twice = 1.96 * np.sqrt(one.covariance[k, k])
            row[f"{length:g} s"] = f"{one.value[k]:.4f} ± {twice:.4f}"
        rows.append(row)
    return pd.DataFrame(rows)


def held_out_figure(done: Sequence[HeldOutRun]) -> Figure:
    """Figure: residual torque of every joint in the first log of each held-out run."""
    joints = done[0].rows[0].joints
    drawn, axes = new_figure(len(done), len(joints), (3.6 * len(joints), 1.9 * len(done)))
    for line, one in zip(axes, done, strict=True):
        t = one.rows[0].t
        for j, (ax, joint) in enumerate(zip(line, joints, strict=True)):
            ax.axhline(0.0, color=INK, linewidth=0.6)
            for rest, color, style, words in (
                (one.zeroed, BEFORE, "--", "zeros alone"),
                (one.after, AFTER, "-", "with the others' sizes"),
            ):
                ax.plot(t, rest[: len(t), j], style, marker=".", color=color, label=words)
            set_title(ax, f"{one.name}, {joint}", 9.0)
    for ax in axes[-1]:
        ax.set_xlabel("time [s]")
    for ax in axes[:, 0]:
        ax.set_ylabel("residual [N m]")
    legend_below(drawn, axes[0, 0], 2)
    return drawn
