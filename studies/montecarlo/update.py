"""A single coverage update: the paper's figure, and the gain from iterating its projection.

That pi < pi+ <= gamma (the paper's remark) is proved in `estimator.updates.coverage`.
"""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import multivariate_normal, norm

from studies.montecarlo.study import FilterScores
from surefoot.estimator import box_moments, posterior_moments
from surefoot.scenarios.reporting import (
    BOUNDS,
    TRUTH,
    estimator_color,
    legend_below,
    new_figure,
    set_title,
)

_POSTERIOR, _MATCHED = estimator_color("coverage"), estimator_color("leg")
_FREE = np.full(2, np.inf)
# Axes without bounds are free, so updates on three axes also give the figures of one and two.
_LINE = np.r_[0.5, -_FREE], np.r_[1.6, _FREE]
_PLANE = np.array([0.4, -0.6, -np.inf]), np.array([1.8, 0.6, np.inf])
_PLANE_COV = np.array([[1.0, 0.6, 0.0], [0.6, 1.0, 0.0], [0.0, 0.0, 1.0]])


def update(mean, cov, lower, upper, gamma: float) -> tuple[float, np.ndarray, np.ndarray, float]:
    """One projection (Theorem 1, moments matched) of N(mean, cov) onto a box.

    Args:
        mean: (3,) of the prior.
        cov: (3, 3) of the prior.
        lower: (3,) of the box; -inf where it is open.
        upper: (3,) of the box; inf where it is open.
        gamma: required mass of the box.

    Returns pi of the prior, mean (3,) and covariance (3, 3) of the posterior, and its pi.
    """
    mean_plus, cov_plus = np.empty(3), np.empty((3, 3))
    pi = posterior_moments(mean, cov, lower, upper, gamma, mean_plus, cov_plus)
    return pi, mean_plus, cov_plus, float(np.exp(box_moments(mean_plus, cov_plus, lower, upper)[0]))


def update_illustration(gamma: float = 0.8) -> Figure:
    """The paper's figure of the update: prior, KL-minimal posterior, moment-matched Gaussian.

    One axis above, two below.
    """
    figure, axes = new_figure(2, 3, size=(9.5, 6.2))
    _draw_line(axes[0], gamma)
    _draw_plane(axes[1], gamma)
    legend_below(figure, axes[0, 2])
    return figure


def iteration_table(rows: Sequence[FilterScores]) -> pd.DataFrame:
    """One row for each regime, filter and number of projections in an update."""
    return pd.DataFrame(
        [
            {
                "regime": row.regime,
                "filter": row.filter,
                "projections": row.iterations,
                "RMSE [m]": f"{row.rmse[0]:.3f} ± {row.rmse[1]:.3f}",
                "NEES": f"{row.nees[0]:.2f} ± {row.nees[1]:.2f}",
                "active [%]": f"{100 * row.active:.0f}",
            }
            for row in rows
        ]
    )


def _draw_line(axes, gamma: float) -> None:
    (lower, *_), (upper, *_) = _LINE
    pi, mean, cov, raised = update(np.zeros(3), np.eye(3), *_LINE, gamma)
    z = np.linspace(-3.2, 3.2, 1201)
    prior = norm.pdf(z)
    inside = (z >= lower) & (z <= upper)
    posterior = prior * np.where(inside, gamma / pi, (1.0 - gamma) / (1.0 - pi))
    curves = [
        (prior, TRUTH, "-", "Prior"),
        (posterior, _POSTERIOR, "-", "KL-minimal posterior"),
        (norm.pdf(z, mean[0], np.sqrt(cov[0, 0])), _MATCHED, "--", "Moment-matched Gaussian"),
    ]
    titles = (
        f"(a) Prior, π = {pi:.2f}",
        f"(b) KL-minimal, γ = {gamma:g}",
        f"(c) Matched Gaussian, π⁺ = {raised:.2f}",
    )
    for k, ax in enumerate(axes):
        ax.axvspan(lower, upper, color=BOUNDS, alpha=0.2, linewidth=0, label="Set C")
        for n, (density, color, style, label) in enumerate(curves[: k + 1]):
            ax.plot(z, density, style, color=color, label=label, alpha=1.0 if n == k else 0.5)
        ax.set(xlabel="z", xlim=(z[0], z[-1]), ylim=(0.0, 1.08 * posterior.max()))
        set_title(ax, titles[k])
    axes[0].set_ylabel("density")


def _draw_plane(axes, gamma: float) -> None:
    lower, upper = _PLANE
    pi, mean, cov, raised = update(np.zeros(3), _PLANE_COV, lower, upper, gamma)
    grid = np.linspace(-3.0, 3.0, 301)
    x, y = np.meshgrid(grid, grid)
    points = np.stack([x, y], axis=-1)
    prior = multivariate_normal(np.zeros(2), _PLANE_COV[:2, :2]).pdf(points)  # pyright: ignore
    inside = ((points >= lower[:2]) & (points <= upper[:2])).all(axis=-1)
    posterior = prior * np.where(inside, gamma / pi, (1.0 - gamma) / (1.0 - pi))
    matched = multivariate_normal(mean[:2], cov[:2, :2]).pdf(points)  # pyright: ignore
    titles = f"π = {pi:.2f}", f"γ = {gamma:g}", f"π⁺ = {raised:.2f}; 1 and 2 σ"
    for k, (ax, density) in enumerate(zip(axes, (prior, posterior, matched), strict=True)):
        ax.pcolormesh(
            x, y, density, cmap="Oranges", vmin=0.0, vmax=posterior.max(), rasterized=True
        )
        (x0, y0), (x1, y1) = lower[:2], upper[:2]
        ax.plot([x0, x1, x1, x0, x0], [y0, y0, y1, y1, y0], color=BOUNDS)
        _ellipses(ax, np.zeros(2), _PLANE_COV[:2, :2], TRUTH, "-")
        if k == 2:
            _ellipses(ax, mean[:2], cov[:2, :2], _MATCHED, "--")
        ax.set(xlabel="z₁", xlim=(-3.0, 3.0), ylim=(-3.0, 3.0))
        ax.set_aspect("equal")
        ax.grid(False)
        set_title(ax, titles[k])
    axes[0].set_ylabel("z₂")


def _ellipses(ax: Axes, mean, cov, color: str, style: str) -> None:
    """Draw the one and two sigma ellipses of a Gaussian.

    Args:
        ax: to draw on.
        mean: (2,) of the Gaussian.
        cov: (2, 2) of the Gaussian.
        color: of the lines.
        style: of the lines, as of matplotlib.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    circle = np.linalg.cholesky(cov) @ np.array([np.cos(angle), np.sin(angle)])
    for size in (1.0, 2.0):
        ax.plot(*(mean[:, None] + size * circle), style, color=color, linewidth=1.4)
    ax.plot(*mean, "x", color=color)
