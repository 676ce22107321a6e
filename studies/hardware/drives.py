"""Torque of a drive beyond the rigid model: a linear balance of smoothed terms.

Positions are differentiated, and all terms, including the measured torque, are smoothed by the same
kernel. The balance thus stays exact, while the noise of the second derivative decreases:

    tau = rigid(q, dq, ddq) + sum of sizes times terms
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from surefoot import Log
from surefoot.extend import STICTION_RATE, Modelled, block_bootstrap_counts, white_noise

GRID = 0.005
"""Largest spacing of the rows of the balance [s]."""
FIRST = 0.010
"""Width of the kernel that smooths positions before differentiation [s]."""
BLOCK = 2.0
"""Length of the blocks of the bootstrap [s], whose errors are nearly independent."""
TOUCHED = 6.0
"""Robust standard deviations beyond which the residual is no drive's: something touched the
machine.
"""
WORTH = 0.05
"""Share of the remaining squares that a further term must explain on blocks that no fit has seen.
"""
AT_FLOOR = 1.2
"""Ratio to the readings' jitter up to which a residual is nothing but that jitter."""
EFFECTS = {
    "torque_scale": "ratio",
    "torque_bias": "N m",
    "torque_delay": "s",
    "viscous_friction": "N m s/rad",
    "coulomb_friction": "N m",
    "armature": "kg m^2",
}
"""Terms of effects in the catalogue, with their units."""
RIVALS = {
    "gravity": "ratio",
    "inertia": "ratio",
    "load_friction": "ratio",
    "drag": "N m s^2/rad^2",
}
"""Terms that are no choice beside them: a mass, a length or an inertia larger by a share, dry
friction proportional to the load, and drag proportional to the squared rate.
"""


@dataclass(frozen=True)
class Balance:
    """The torques of a log and the terms that may explain them, smoothed by one kernel.

    Attributes:
        name: of the log.
        joints: their names.
        t: times (N,) [s].
        tau: measured torques (N, J) [N m].
        rigid: torques of the declared model (N, J) [N m].
        terms: name -> torque per unit of the term's size (N, J).
        good: rows to use (N, J).
        floor: standard deviation of tau - rigid from the jitter of the readings (J,) [N m].
        noise: see below; sums over several balances are weighted by it.
    """

    name: str
    joints: tuple[str, ...]
    t: np.ndarray
    tau: np.ndarray
    rigid: np.ndarray
    terms: dict[str, np.ndarray]
    good: np.ndarray
    floor: np.ndarray
    noise: np.ndarray
    """Robust standard deviation of what all terms together leave unexplained (J,) [N m]."""

    @property
    def block(self) -> np.ndarray:
        """Number of each row's block (N,)."""
        return np.floor((self.t - self.t[0]) / BLOCK).astype(int)


@dataclass(frozen=True)
class Sizes:
    """Sizes (C,) of some terms of one joint, fitted together, with 95 % intervals (C, 2)."""

    names: tuple[str, ...]
    values: np.ndarray
    interval: np.ndarray


def balance(log: Log, machine: Modelled, width: float, stops: float = 0.0) -> Balance:
    """The balance of a log of a machine on a fixed base, level and at rest.

    width [s]: standard deviation of the Gaussian kernel. Rows of a joint within `stops` [rad] of
    the end of its range, and their neighbours, are left out, since the stop bears a part of the
    torque there. Raises LogError if the log lacks q or tau.
    """
    log.require("q", "tau")
    step = min(GRID, float(np.median(np.diff(log.t))))
    t = np.arange(log.t[0], log.t[-1], step)
    q_read = CubicSpline(log.t, log.q)(t)
    tau_read = np.column_stack([np.interp(t, log.t, column) for column in log.tau.T])

    def first(x: np.ndarray) -> np.ndarray:
        return gaussian_filter1d(x, FIRST / step, axis=0, mode="nearest")

    def smooth(x: np.ndarray) -> np.ndarray:
        return gaussian_filter1d(x, width / step, axis=0, mode="nearest")

    q = first(q_read)
    dq = np.gradient(q, step, axis=0)
    ddq = np.gradient(dq, step, axis=0)
    none, dynamics = np.zeros_like(q), machine.dynamics

    def torque(dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        return dynamics.inverse(q, dq, ddq)[1]

    gravity, rigid = torque(none, none), torque(dq, ddq)
    inertia = torque(none, ddq) - gravity
    sense = np.tanh(dq / STICTION_RATE)
    terms = {
        "torque_scale": rigid,
        "torque_bias": np.ones_like(q),
        "torque_delay": -np.gradient(rigid, step, axis=0),
        "viscous_friction": dq,
        "coulomb_friction": sense,
        "armature": ddq,
        "gravity": gravity,
        "inertia": inertia,
        "load_friction": sense * np.abs(rigid),
        "drag": dq * np.abs(dq),
    }
    edge = int(np.ceil(3 * (FIRST + width) / step))
    good = np.zeros(q.shape, dtype=bool)
    good[edge:-edge] = True
    if stops:
        low, high = ranges(dynamics.model, dynamics.dof_adr)
        at_stop = (q < low + stops) | (q > high - stops)
        near = maximum_filter1d(at_stop.astype(float), 2 * int(np.ceil(2 * width / step)) + 1, 0)
        good &= near == 0.0
    tau = smooth(first(tau_read))
    smoothed = {name: smooth(x) for name, x in terms.items()}
    floor = _floor(log, dynamics, q, width)
    noise = np.ones(len(log.joints))
    one = Balance(log.name, log.joints, t, tau, smooth(rigid), smoothed, good, floor, noise)
    return _without_touches(one, edge)


def ranges(model: mujoco.MjModel, dof_adr: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper limits (J,) [rad] of the joints of these degrees of freedom; infinite where
    the model has no stop.
    """
    joints = model.dof_jntid[dof_adr]
    free = model.jnt_limited[joints] == 0
    low, high = model.jnt_range[joints].T
    return np.where(free, -np.inf, low), np.where(free, np.inf, high)


def fit_sizes(
    balances: Sequence[Balance],
    joint: int,
    names: Sequence[str],
    rng: np.random.Generator,
    samples: int = 1000,
) -> Sizes:
    """Least squares of these terms on the good rows of one joint.

    Intervals are percentiles of a bootstrap over the blocks of all balances; NaN without samples.

    Args:
        balances: of each log.
        joint: its index.
        names: of the terms.
        rng: draws the bootstrap's blocks.
        samples: of the bootstrap.
    """
    G = np.concatenate([_products(one, joint, names, one.good[:, joint]) for one in balances])
    values = _solved(G.sum(axis=0))
    if not samples:
        return Sizes(tuple(names), values, np.full((len(names), 2), np.nan))
    counts = block_bootstrap_counts(len(G), rng, samples)
    drawn = np.array([_solved(np.tensordot(one, G, 1)) for one in counts])
    interval = np.percentile(drawn, [2.5, 97.5], axis=0).T.reshape(-1, 2)
    return Sizes(tuple(names), values, interval)


def left(one: Balance, joint: int, sizes: Sizes | None = None) -> np.ndarray:
    """Residual torque (N,) [N m] of a joint less the fitted terms; NaN where not good."""
    rest = one.tau[:, joint] - one.rigid[:, joint]
    if sizes is not None:
        for name, value in zip(sizes.names, sizes.values, strict=True):
            rest = rest - value * one.terms[name][:, joint]
    return np.where(one.good[:, joint], rest, np.nan)


def rms(rest: np.ndarray) -> float:
    """Root mean square of a residual [its unit], without NaN."""
    return float(np.sqrt(np.nanmean(rest**2)))


def level_interval(
    parts: Sequence[tuple[Balance, np.ndarray]], rng: np.random.Generator
) -> tuple[float, float]:
    """95 % interval of the root mean square of residuals, by bootstrap over blocks."""
    squares, counts = [], []
    for one, rest in parts:
        for number in np.unique(one.block):
            own = rest[(one.block == number) & np.isfinite(rest)]
            if len(own):
                squares.append(float(np.sum(own**2)))
                counts.append(len(own))
    low, high = np.sqrt(ratio_interval(np.array(squares), np.array(counts), rng))
    return float(low), float(high)


def ratio_interval(top: np.ndarray, bottom: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """95 % interval (2,) of sum(top) / sum(bottom) over blocks (B,), by bootstrap."""
    draws = block_bootstrap_counts(len(top), rng)
    return np.percentile((draws @ top) / (draws @ bottom), [2.5, 97.5])


def between(value: float, interval: Sequence[float] | np.ndarray, digits: int = 3) -> str:
    """'0.120 (0.110 – 0.130)'."""
    low, high = interval
    return f"{value:.{digits}f} ({low:.{digits}f} – {high:.{digits}f})"


def select(
    balances: Sequence[Balance], joint: int, names: Sequence[str], worth: float = WORTH
) -> tuple[str, ...]:
    """Forward selection of terms: each time the one that most reduces the residual of unseen
    blocks.

    Even blocks are fitted and odd ones evaluated, and the other way round. Selection ends when no
    term explains the share `worth` of the remaining squares, or these are down to the readings'
    jitter.
    """
    chosen: list[str] = []
    now = _judged(balances, joint, chosen)
    jitter = sum(
        one.good[:, joint].sum() * (one.floor[joint] / one.noise[joint]) ** 2 for one in balances
    )
    while len(chosen) < len(names) and now > AT_FLOOR**2 * jitter:
        levels = {n: _judged(balances, joint, [*chosen, n]) for n in names if n not in chosen}
        best = min(levels, key=lambda n: levels[n])
        if levels[best] > (1.0 - worth) * now:
            break
        chosen, now = [*chosen, best], levels[best]
    return tuple(chosen)


def _judged(balances: Sequence[Balance], joint: int, names: Sequence[str]) -> float:
    """Sum of squares that remain on the blocks not fitted, each half in turn."""
    total = 0.0
    for side in (0, 1):
        fitted = [one.good[:, joint] & (one.block % 2 == side) for one in balances]
        G = np.concatenate(
            [_products(b, joint, names, rows) for b, rows in zip(balances, fitted, strict=True)]
        )
        sizes = _solved(G.sum(axis=0))
        for one in balances:
            unseen = one.good[:, joint] & (one.block % 2 != side)
            vector = np.concatenate([[1.0], -sizes])
            total += float(vector @ _products(one, joint, names, unseen).sum(axis=0) @ vector)
    return total


def _products(one: Balance, joint: int, names: Sequence[str], rows: np.ndarray) -> np.ndarray:
    """Sums of products (K, 1 + C, 1 + C) of residual and terms over each block."""
    A = np.column_stack(
        [one.tau[:, joint] - one.rigid[:, joint], *(one.terms[n][:, joint] for n in names)]
    )
    numbers = np.unique(one.block)
    inside = [A[rows & (one.block == number)] for number in numbers]
    return np.array([a.T @ a for a in inside]) / one.noise[joint] ** 2


def _solved(G: np.ndarray) -> np.ndarray:
    normal, right = G[1:, 1:], G[1:, 0]
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    inverse = np.linalg.pinv(normal / scale / scale[:, None], rcond=1e-10, hermitian=True)
    return inverse @ (right / scale) / scale


def _without_touches(one: Balance, edge: int) -> Balance:
    """The balance without sections that all terms together cannot explain."""
    good, noise = one.good.copy(), one.noise.copy()
    for joint in range(len(one.joints)):
        names = (*EFFECTS, *RIVALS)
        spread = 1.0
        for _ in range(3):
            G = _products(one, joint, names, good[:, joint]).sum(axis=0)
            sizes = Sizes(names, _solved(G), np.empty((0, 2)))
            rest = left(one, joint, sizes)
            spread = 1.4826 * np.nanmedian(np.abs(rest[good[:, joint]]))
            touched = np.abs(np.nan_to_num(rest)) > TOUCHED * spread
            good[:, joint] &= maximum_filter1d(touched.astype(float), 2 * edge + 1) == 0.0
        noise[joint] = spread
    return replace(one, good=good, noise=noise)


def _floor(log: Log, dynamics, q: np.ndarray, width: float) -> np.ndarray:
    """Standard deviation (J,) of the balance from white jitter of the readings.

    A Gaussian kernel of width s over rows dt apart reduces a variance to the share
    dt / (2 s sqrt(pi)), and that of a second derivative to 3 dt / (8 s^5 sqrt(pi)).
    """
    dt = float(np.median(np.diff(log.t)))
    s = float(np.hypot(width, FIRST))

    heavy = np.empty(q.shape[1])
    for j in range(q.shape[1]):
        unit = np.zeros_like(q[:1])
        unit[0, j] = 1.0
        still = np.zeros_like(unit)
        heavy[j] = (
            dynamics.inverse(q[:1], still, unit)[1] - dynamics.inverse(q[:1], still, still)[1]
        )[0, j]
    torque = white_noise(_read_torque(log)) * np.sqrt(dt / (2 * s * np.sqrt(np.pi)))
    inertial = heavy * white_noise(log.q) * np.sqrt(3 * dt / (8 * s**5 * np.sqrt(np.pi)))
    return np.hypot(torque, inertial)


def _read_torque(log: Log) -> np.ndarray:
    """The torque (N, J) without its noise-free part: the jumps of a motor law's targets."""
    if "tau (motor law)" not in log.meta.derived or log.meta.motor_law is None:
        return log.tau
    return log.tau - np.array(log.meta.motor_law["kp"]) * log.q_des
