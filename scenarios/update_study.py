"""The coverage update by itself: the paper's illustration from our code, and its remark studied."""

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from estimator.box import box_moments
from estimator.coverage import posterior_moments
from scenarios.palette import BOUNDS, INK, TRUTH, estimator_color
from scenarios.plotting import legend_below, new_figure, set_title
from scenarios.qmc import ordinary_boxes

_POSTERIOR = estimator_color("coverage")
_MATCHED = estimator_color("leg")


@dataclass(frozen=True)
class Remark:
    """Whether pi < pi+ <= gamma holds, over boxes on which the update is active.

    gamma; active: how many boxes; raised and within: the shares of them with pi+ > pi and with
    pi+ <= gamma; below: the mean of gamma - pi+ after one projection, and after_five: after five.
    """

    gamma: float
    active: int
    raised: float
    within: float
    below: float
    after_five: float


def study_remark(rng: np.random.Generator, gammas: tuple[float, ...], boxes: int) -> list[Remark]:
    """The mass of the moment-matched Gaussian in random boxes, a row for each gamma.

    Boxes are wider than `ordinary_boxes` by up to two deviations a side and lie up to three from
    the prior's mean, so that pi runs from nothing to above gamma.
    """
    means, covs, lowers, uppers = ordinary_boxes(rng, boxes)
    wider, shift = rng.uniform(0.0, 2.0, (boxes, 3)), rng.uniform(-2.0, 2.0, (boxes, 3))
    lowers, uppers = lowers - wider, uppers + wider
    rows = []
    for gamma in gammas:
        masses = []
        for box in zip(means, covs, lowers + shift, uppers + shift, strict=True):
            mean, cov, lower, upper = box
            chain = []
            for _ in range(5):
                before, mean, cov = update(mean, cov, lower, upper, gamma)
                chain.append(before)
                if before >= gamma:
                    break
            if len(chain) > 1:
                last = float(np.exp(box_moments(mean, cov, lower, upper)[0]))
                masses.append((chain[0], chain[1], last))
        pi, once, last = np.array(masses).reshape(-1, 3).T
        rows.append(
            Remark(
                gamma,
                len(pi),
                float(np.mean(once > pi)),
                float(np.mean(once <= gamma)),
                float(np.mean(gamma - once)),
                float(np.mean(gamma - last)),
            )
        )
    return rows


def update(mean, cov, lower, upper, gamma: float) -> tuple[float, np.ndarray, np.ndarray]:
    """pi of the prior, and mean (3,) and covariance (3, 3) of the matched posterior."""
    mean_plus, cov_plus = np.empty(3), np.empty((3, 3))
    pi = posterior_moments(
        np.asarray(mean, dtype=float), np.asarray(cov, dtype=float), np.asarray(lower, dtype=float),
        np.asarray(upper, dtype=float), gamma, mean_plus, cov_plus,
    )  # fmt: skip
    return pi, mean_plus, cov_plus


def update_illustration(gamma: float = 0.8) -> Figure:
    """Prior, piecewise posterior and moment-matched Gaussian, in one dimension and in two.

    Free axes have infinite bounds, so both are the update of the filter itself. The paper's figure
    of the update shows the same three.
    """
    figure, axes = new_figure(1, 2, size=(9.0, 4.2))
    _draw_line(axes[0, 0], gamma)
    _draw_plane(axes[0, 1], gamma)
    legend_below(figure, axes[0, 0])
    return figure


def _draw_line(ax, gamma: float) -> None:
    lower, upper = 0.5, 1.6
    free = np.full(2, np.inf)
    pi, mean, cov = update(
        np.zeros(3), np.eye(3), np.r_[lower, -free], np.r_[upper, free], gamma
    )  # fmt: skip
    z = np.linspace(-3.2, 3.2, 1201)
    prior = _density(z, 0.0, 1.0)
    inside = (z >= lower) & (z <= upper)
    posterior = prior * np.where(inside, gamma / pi, (1.0 - gamma) / (1.0 - pi))
    ax.axvspan(lower, upper, color=BOUNDS, alpha=0.2, linewidth=0, label="Box C")
    ax.plot(z, prior, color=TRUTH, linewidth=2.0, label=f"Prior (π = {pi:.2f})")
    ax.plot(z, posterior, color=_POSTERIOR, label=f"KL-minimal posterior (γ = {gamma:g})")
    matched = _density(z, mean[0], cov[0, 0])
    ax.plot(z, matched, "--", color=_MATCHED, label="Moment-matched Gaussian")
    ax.set(xlabel="z", ylabel="density", xlim=(z[0], z[-1]), ylim=(0.0, None))
    set_title(ax, "One axis")


def _draw_plane(ax, gamma: float) -> None:
    cov = np.array([[1.0, 0.6, 0.0], [0.6, 1.0, 0.0], [0.0, 0.0, 1.0]])
    lower, upper = np.array([0.4, -0.6, -np.inf]), np.array([1.8, 0.6, np.inf])
    pi, mean_plus, cov_plus = update(np.zeros(3), cov, lower, upper, gamma)
    grid = np.linspace(-3.0, 3.0, 401)
    x, y = np.meshgrid(grid, grid)
    prior = _density_2d(x, y, np.zeros(2), cov[:2, :2])
    inside = (x >= lower[0]) & (x <= upper[0]) & (y >= lower[1]) & (y <= upper[1])
    posterior = prior * np.where(inside, gamma / pi, (1.0 - gamma) / (1.0 - pi))
    ax.pcolormesh(x, y, posterior, cmap="Oranges", shading="auto", rasterized=True)
    ax.plot(
        [lower[0], upper[0], upper[0], lower[0], lower[0]],
        [lower[1], lower[1], upper[1], upper[1], lower[1]],
        color=BOUNDS,
    )
    for mean, spread, color, style in (
        (np.zeros(2), cov[:2, :2], TRUTH, "-"),
        (mean_plus[:2], cov_plus[:2, :2], _MATCHED, "--"),
    ):
        angle = np.linspace(0.0, 2.0 * np.pi, 200)
        circle = np.linalg.cholesky(spread) @ np.array([np.cos(angle), np.sin(angle)])
        for size in (1.0, 2.0):
            ax.plot(*(mean[:, None] + size * circle), style, color=color, linewidth=1.4)
    ax.plot(*mean_plus[:2], "x", color=_MATCHED)
    ax.plot(0.0, 0.0, "+", color=INK)
    ax.set(xlabel="z₁", ylabel="z₂", xlim=(-3.0, 3.0), ylim=(-3.0, 3.0))
    ax.set_aspect("equal")
    ax.grid(False)
    set_title(ax, f"Two axes (π = {pi:.2f}); ellipses at 1 and 2 σ")


def _density(z: np.ndarray, mean: float, variance: float) -> np.ndarray:
    return np.exp(-0.5 * (z - mean) ** 2 / variance) / np.sqrt(2.0 * np.pi * variance)


def _density_2d(x: np.ndarray, y: np.ndarray, mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
    d = np.stack([x - mean[0], y - mean[1]], axis=-1)
    distance = np.einsum("...i,ij,...j->...", d, np.linalg.inv(cov), d)
    return np.exp(-0.5 * distance) / (2.0 * np.pi * np.sqrt(np.linalg.det(cov)))
