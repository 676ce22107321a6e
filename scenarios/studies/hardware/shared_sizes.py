"""Several runs of one chain of joints: sizes that all share, zeros that each run has of its own.

The balance of torques (`drives`) of all joints together, linear in the sizes of effects:

    tau = rigid(q, dq, ddq) + shared sizes times terms + own zeros times terms

Zeros are eliminated log by log, so that what is left of each log is a small matrix of products:
logs are held out, sizes fitted and intervals drawn from sums of these.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from surefoot.models.bootstrap import block_draws
from surefoot.scenarios.reporting.palette import AFTER, BEFORE, INK
from surefoot.scenarios.reporting.plotting import legend_below, new_figure, set_title
from surefoot.scenarios.studies.hardware.drives import Balance, balance, between, rms
from surefoot.sim.effects import compensate_all, effect, known_effects
from surefoot.sim.log import Log
from surefoot.sim.robot.fixed_base import Machine

ZERO = 0.03
"""rad, standard deviation of a zero that was set by hand, with the machine hanging or by marks."""
WORTH_A_SIZE = 0.05
"""Share of the squares left of runs that were not fitted that a further term must take off."""
_ALIKE = 10.0
"""Rows 5 ms apart that resemble each other behind a kernel of 40 ms."""
RESISTS = ("coulomb_friction", "viscous_friction", "armature")
DRIVEN = ("torque_scale",)
"""Effects of any joint, and those of one with a drive, whose torque is a reading; its zero is to a
swing what one of its angle is."""
LINKS = ("link_mass", "link_com", "link_inertia")
"""Effects of the bodies that joints move."""

SizeKey = tuple[str, str]
Runs = Mapping[str, Sequence[Log]]
"""Logs by the run that they are of: a run that is cut into pieces is held out whole."""


@dataclass(frozen=True)
class RunRows:
    """One log's balance as equations of all J joints.

    balance: of the log; terms: by effect and target, torque (N, J) per unit of its size; zeros
    (J, N, J): the same per rad of each joint's zero.
    """

    balance: Balance
    terms: dict[SizeKey, np.ndarray]
    zeros: np.ndarray

    @property
    def rest(self) -> np.ndarray:
        """Torque (N, J) that the declared model lacks, NaN where it is not used."""
        one = self.balance
        return np.where(one.good, one.tau - one.rigid, np.nan)

    def left(self, sizes: Mapping[SizeKey, float], noise: np.ndarray) -> np.ndarray:
        """What is left (N, J) with shared sizes and the zeros that then fit this log best."""
        rest = self.rest - sum(size * self.terms[key] for key, size in sizes.items())
        return rest - np.tensordot(self.own_zeros(rest, noise), self.zeros, 1)

    def own_zeros(self, rest: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """The zeros (J,) [rad] that explain most of a residual (N, J); noise (J,) weighs joints."""
        used = self.balance.good
        A = np.where(used, self.zeros / noise, 0.0).reshape(len(self.zeros), -1)
        y = np.where(used, rest / noise, 0.0).ravel()
        return np.linalg.solve(A @ A.T + np.eye(len(A)) * _prior(used), A @ y)


@dataclass(frozen=True)
class SharedSizes:
    """Sizes of effects that all runs share, with 95 % intervals; noise (J,) [N m] weighs joints."""

    sizes: dict[SizeKey, float]
    interval: dict[SizeKey, tuple[float, float]]
    noise: np.ndarray


@dataclass(frozen=True)
class HeldOutRun:
    """A run, judged with the sizes that the others chose and fitted. Residuals by log, each (N, J)
    [N m]: of the declared model, with zeros of its own alone, and with the shared sizes too."""

    name: str
    found: SharedSizes
    rows: tuple[RunRows, ...]
    before: tuple[np.ndarray, ...]
    zeroed: tuple[np.ndarray, ...]
    after: tuple[np.ndarray, ...]


def rows_of(log: Log, machine: Machine, width: float) -> RunRows:
    """The equations of one log through a kernel of `width` [s]. A joint whose torque is always zero
    has no drive. Raises LogError where the log lacks q or tau."""
    one = balance(log, machine, width)

    def changed(name: str, target: str) -> np.ndarray:
        step = known_effects()[name].step_of(target)
        known = balance(*compensate_all([effect(name, target, step)], log, machine), width)
        return (known.rigid - one.rigid) / step

    driven = np.ptp(log.tau, axis=0) > 0.0
    terms: dict[SizeKey, np.ndarray] = {}
    for j, joint in enumerate(log.joints):
        for name in (*RESISTS, *(DRIVEN if driven[j] else ())):
            terms[name, joint] = np.zeros_like(one.tau)
            terms[name, joint][:, j] = one.terms[name][:, j]
    for name in LINKS:
        for target in known_effects()[name].targets_on(machine.limbs):
            term = changed(name, target)
            if np.ptp(term) > 0.0:  # along the axis of a hinge a mass may lie anywhere
                terms[name, target] = term
    # A reading that is too large by its zero is compensated by as much less.
    zeros = np.stack([changed("encoder_offset", joint) for joint in log.joints])
    return RunRows(one, terms, zeros)


def runs_left_out(
    logs: Runs, machine: Machine, width: float, seed: int = 0
) -> tuple[HeldOutRun, ...]:
    """Each run with the effects that the others chose and sized, and zeros of its own.

    Args:
        logs: by run.
        machine: as declared.
        width: of the kernel [s].
        seed: of the bootstrap over logs.
    """
    rows = {run: [rows_of(log, machine, width) for log in own] for run, own in logs.items()}
    done = []
    for run, own in rows.items():
        found = fit_shared({k: v for k, v in rows.items() if k != run}, machine, seed)
        none, noise = {}, found.noise
        done.append(
            HeldOutRun(
                name=run,
                found=found,
                rows=tuple(own),
                before=tuple(one.rest for one in own),
                zeroed=tuple(one.left(none, noise) for one in own),
                after=tuple(one.left(found.sizes, noise) for one in own),
            )
        )
    return tuple(done)


def fit_shared(
    rows: Mapping[str, Sequence[RunRows]], machine: Machine, seed: int = 0
) -> SharedSizes:
    """Effects chosen one by one, each that which most lowers what is left of runs not fitted, and
    their sizes from all runs; one whose size is beyond its bounds is not taken."""
    every = [one for own in rows.values() for one in own]
    noise = np.sqrt(np.nanmean(np.concatenate([one.rest for one in every]) ** 2, axis=0))
    keys = list(every[0].terms)
    products = {
        run: np.array([_products(r, keys, noise) for r in own]) for run, own in rows.items()
    }
    chosen: list[int] = []
    now = _unseen(products, chosen)
    while len(chosen) < len(keys):
        others = [k for k in range(len(keys)) if k not in chosen]
        levels = {k: _unseen(products, [*chosen, k]) for k in others}
        able = [k for k in others if _within(products, [*chosen, k], keys, machine)]
        best = min(able, key=lambda k: levels[k], default=None)
        if best is None or levels[best] > (1.0 - WORTH_A_SIZE) * now:
            break
        chosen, now = [*chosen, best], levels[best]
    G = np.concatenate(list(products.values()))
    counts = block_draws(len(G), np.random.default_rng(seed))
    sizes = _solved(G.sum(axis=0), chosen)
    drawn = np.array([_solved(np.tensordot(one, G, 1), chosen) for one in counts])
    low, high = np.percentile(drawn, [2.5, 97.5], axis=0)
    names = [keys[k] for k in chosen]
    interval = dict(zip(names, zip(map(float, low), map(float, high), strict=True), strict=True))
    return SharedSizes(dict(zip(names, map(float, sizes), strict=True)), interval, noise)


def left_out_table(done: Sequence[HeldOutRun]) -> pd.DataFrame:
    """A row a run and joint: root mean square of the residual torque, and what fitted the zeros."""
    return pd.DataFrame(
        {
            "run held out": one.name,
            "joint": joint,
            "declared model [N m]": f"{rms(_joint(one.before, j)):.3f}",
            "with zeros of its own [N m]": f"{rms(_joint(one.zeroed, j)):.3f}",
            "and the others' effects [N m]": f"{rms(_joint(one.after, j)):.3f}",
            "left [% of zeros alone]": f"{_share(one, j):.0f}",
        }
        for one in done
        for j, joint in enumerate(one.rows[0].balance.joints)
    )


def shared_sizes_table(whole: SharedSizes, done: Sequence[HeldOutRun]) -> pd.DataFrame:
    """A row an effect: size by all runs, and without each; a dash where it was not chosen."""
    rows = []
    for key, size in whole.sizes.items():
        name, target = key
        row = {
            "effect": f"{name.replace('_', ' ')} {target}",
            "unit": known_effects()[name].unit,
            "size (95 % interval)": between(size, whole.interval[key], 4),
        }
        without = {f"without {one.name}": one.found.sizes.get(key) for one in done}
        rows.append(row | {k: "–" if x is None else f"{x:.4f}" for k, x in without.items()})
    return pd.DataFrame(rows)


def held_out_figure(done: Sequence[HeldOutRun]) -> Figure:
    """Of each run held out its first log: what is left of every joint's torque."""
    joints = done[0].rows[0].balance.joints
    drawn, axes = new_figure(len(done), len(joints), (3.6 * len(joints), 1.9 * len(done)))
    for line, one in zip(axes, done, strict=True):
        t = one.rows[0].balance.t
        for j, (ax, joint) in enumerate(zip(line, joints, strict=True)):
            ax.axhline(0.0, color=INK, linewidth=0.6)
            ax.plot(t - t[0], one.zeroed[0][:, j], "--", color=BEFORE, label="zeros alone")
            ax.plot(t - t[0], one.after[0][:, j], color=AFTER, label="with the others' effects")
            set_title(ax, f"{one.name}, {joint}", 9.0)
    for ax in axes[-1]:
        ax.set_xlabel("time [s]")
    for ax in axes[:, 0]:
        ax.set_ylabel("left [N m]")
    legend_below(drawn, axes[0, 0], 2)
    return drawn


def _joint(parts: Sequence[np.ndarray], j: int) -> np.ndarray:
    return np.concatenate([part[:, j] for part in parts])


def _share(one: HeldOutRun, j: int) -> float:
    return 100.0 * rms(_joint(one.after, j)) / rms(_joint(one.zeroed, j))


def _prior(used: np.ndarray) -> float:
    """Weight of a zero's prior beside rows (N, J)."""
    return _ALIKE / ZERO**2 if used.any() else 1.0


def _products(one: RunRows, keys: Sequence[SizeKey], noise: np.ndarray) -> np.ndarray:
    """Products (1 + C, 1 + C) of residual and terms, what zeros explain of them taken off."""
    used = one.balance.good
    columns = [one.balance.tau - one.balance.rigid, *(one.terms[key] for key in keys), *one.zeros]
    A = np.array([np.where(used, c / noise, 0.0).ravel() for c in columns])
    G, n = A @ A.T, 1 + len(keys)
    own = G[n:, n:] + np.eye(len(one.zeros)) * _prior(used)
    return G[:n, :n] - G[:n, n:] @ np.linalg.solve(own, G[n:, :n])


def _solved(G: np.ndarray, chosen: Sequence[int]) -> np.ndarray:
    """Sizes of the chosen terms by sums of products."""
    at = 1 + np.array(chosen, dtype=int)
    scale = np.sqrt(np.maximum(np.diag(G)[at], 1e-300))
    normal = G[np.ix_(at, at)] / scale / scale[:, None]
    return np.linalg.pinv(normal, rcond=1e-10, hermitian=True) @ (G[at, 0] / scale) / scale


def _unseen(products: Mapping[str, np.ndarray], chosen: Sequence[int]) -> float:
    """Sum of squares left of each run with the sizes of the others."""
    whole = sum(G.sum(axis=0) for G in products.values())
    at = [0, *(1 + k for k in chosen)]
    total = 0.0
    for G in products.values():
        own = G.sum(axis=0)
        vector = np.concatenate([[1.0], -_solved(whole - own, chosen)])
        total += float(vector @ own[np.ix_(at, at)] @ vector)
    return total


def _within(
    products: Mapping[str, np.ndarray],
    chosen: Sequence[int],
    keys: Sequence[SizeKey],
    machine: Machine,
) -> bool:
    """Whether the sizes of the chosen terms are within their effects' bounds."""
    sizes = _solved(np.sum([G.sum(axis=0) for G in products.values()], axis=0), chosen)
    for k, size in zip(chosen, sizes, strict=True):
        name, target = keys[k]
        low, high = known_effects()[name].inside(target)
        if not low <= size <= high:
            return False
    return True
