"""Pictures of one coverage update: the paper's illustration by our code, its remark mapped."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from surefoot.scenarios.reporting.palette import BOUNDS, INK, TRUTH, estimator_color
from surefoot.scenarios.reporting.plotting import legend_below, new_figure, set_title
from surefoot.scenarios.studies.montecarlo.update_study import masses, update

_POSTERIOR, _MATCHED = estimator_color("coverage"), estimator_color("leg")
_FREE = np.full(2, np.inf)
_LINE = np.r_[0.5, -_FREE], np.r_[1.6, _FREE]
_PLANE = np.array([0.4, -0.6, -np.inf]), np.array([1.8, 0.6, np.inf])
_PLANE_COV = np.array([[1.0, 0.6, 0.0], [0.6, 1.0, 0.0], [0.0, 0.0, 1.0]])


def update_illustration(gamma: float = 0.8) -> Figure:
    """The paper's figure of the update: prior, KL-minimal posterior, moment-matched Gaussian.

    One axis above, two below. Free axes have infinite bounds, so both are the filter's own update.
    """
    figure, axes = new_figure(2, 3, size=(9.5, 6.2))
    _draw_line(axes[0], gamma)
    _draw_plane(axes[1], gamma)
    legend_below(figure, axes[0, 2])
    return figure


def gap_on_one_axis(centres, halves, gamma: float) -> np.ndarray:
    """Share (H, C) of the gap gamma - pi that one update closes; NaN where pi >= gamma.

    The box is centre -+ half on one axis, in deviations of the prior.
    """
    return np.array(
        [
            [_closed(np.eye(3), np.r_[c - h, -_FREE], np.r_[c + h, _FREE], gamma) for c in centres]
            for h in halves
        ]
    )


def gap_on_three_axes(distances, correlations, half: float, gamma: float) -> np.ndarray:
    """The same share (R, D) for cubes of that half width, moved along the cube's diagonal.

    All three correlations of the prior are equal, in (-1/2, 1).
    """
    return np.array(
        [
            [_closed(np.full((3, 3), r) + (1 - r) * np.eye(3), *_cube(d, half), gamma)
             for d in distances]
            for r in correlations
        ]
    )  # fmt: skip


def remark_figure(gamma: float = 0.8) -> Figure:
    """Where an update gets to between pi and gamma: by place, width, correlation, iterations."""
    figure, axes = new_figure(1, 3, size=(10.5, 3.9))
    places, halves = np.linspace(0.0, 5.0, 61), np.linspace(0.05, 4.0, 60)
    shown = _map(axes[0, 0], places, halves, gap_on_one_axis(places, halves, gamma))
    axes[0, 0].set(xlabel="box centre [σ]", ylabel="half width [σ]")
    set_title(axes[0, 0], "One axis")
    correlations, half = np.linspace(-0.48, 0.98, 50), 1.0
    share = gap_on_three_axes(places, correlations, half, gamma)
    _map(axes[0, 1], places, correlations, share)
    axes[0, 1].set(xlabel="cube's distance [σ]", ylabel="correlation")
    set_title(axes[0, 1], "Three axes, half width 1 σ")
    figure.colorbar(shown, ax=axes[0, :2], label="share of γ − π closed", shrink=0.9)
    _draw_iterations(axes[0, 2], gamma)
    return figure


def _closed(cov, lower, upper, gamma: float) -> float:
    chain = masses(np.zeros(3), cov, lower, upper, gamma, 1)
    return (chain[1] - chain[0]) / (gamma - chain[0]) if len(chain) > 1 else np.nan


def _cube(distance: float, half: float) -> tuple[np.ndarray, np.ndarray]:
    centre = np.full(3, distance / np.sqrt(3.0))
    return centre - half, centre + half


def _map(ax: Axes, x, y, share):
    ax.set_facecolor("#EFEFEF")
    ax.grid(False)
    return ax.pcolormesh(x, y, share, cmap="viridis", vmin=0.0, vmax=1.0, rasterized=True)


def _draw_iterations(ax: Axes, gamma: float) -> None:
    for distance, half in ((0.0, 0.5), (0.0, 1.2), (2.0, 1.0), (4.0, 1.0), (8.0, 1.0)):
        chain = masses(np.zeros(3), np.eye(3), *_cube(distance, half), gamma, 12)
        ax.plot(range(len(chain)), chain, "o-", markersize=3, label=f"{distance:g} σ, ±{half:g} σ")
    ax.axhline(gamma, color=INK, linewidth=0.8)
    ax.set(xlabel="projections", ylabel="mass in the box", ylim=(-0.02, 1.0))
    ax.legend(fontsize=7.5, loc="lower right")
    set_title(ax, "Repeated (line: γ)")


def _draw_line(axes, gamma: float) -> None:
    (lower, *_), (upper, *_) = _LINE
    pi, mean, cov = update(np.zeros(3), np.eye(3), *_LINE, gamma)
    z = np.linspace(-3.2, 3.2, 1201)
    prior = _density(z, 0.0, 1.0)
    inside = (z >= lower) & (z <= upper)
    posterior = prior * np.where(inside, gamma / pi, (1.0 - gamma) / (1.0 - pi))
    matched = _density(z, mean[0], cov[0, 0])
    raised = masses(np.zeros(3), np.eye(3), *_LINE, gamma, 1)[-1]
    titles = f"(a) Prior, π = {pi:.2f}", f"(b) KL-minimal, γ = {gamma:g}", "(c) Matched Gaussian"
    for k, ax in enumerate(axes):
        ax.axvspan(lower, upper, color=BOUNDS, alpha=0.2, linewidth=0, label="Set C")
        curves = [
            (prior, TRUTH, "-", "Prior"),
            (posterior, _POSTERIOR, "-", "KL-minimal posterior"),
            (matched, _MATCHED, "--", "Moment-matched Gaussian"),
        ]
        for n, (density, color, style, label) in enumerate(curves[: k + 1]):
            ax.plot(z, density, style, color=color, label=label, alpha=1.0 if n == k else 0.5)
        ax.set(xlabel="z", xlim=(z[0], z[-1]), ylim=(0.0, 1.08 * posterior.max()))
        set_title(ax, titles[k] + (f", π⁺ = {raised:.2f}" if k == 2 else ""))
    axes[0].set_ylabel("density")


def _draw_plane(axes, gamma: float) -> None:
    lower, upper = _PLANE
    pi, mean, cov = update(np.zeros(3), _PLANE_COV, lower, upper, gamma)
    raised = masses(np.zeros(3), _PLANE_COV, lower, upper, gamma, 1)[-1]
    grid = np.linspace(-3.0, 3.0, 301)
    x, y = np.meshgrid(grid, grid)
    prior = _density_2d(x, y, np.zeros(2), _PLANE_COV[:2, :2])
    inside = (x >= lower[0]) & (x <= upper[0]) & (y >= lower[1]) & (y <= upper[1])
    posterior = prior * np.where(inside, gamma / pi, (1.0 - gamma) / (1.0 - pi))
    matched = _density_2d(x, y, mean[:2], cov[:2, :2])
    titles = f"π = {pi:.2f}", f"γ = {gamma:g}", f"π⁺ = {raised:.2f}; 1 and 2 σ"
    for k, (ax, density) in enumerate(zip(axes, (prior, posterior, matched), strict=True)):
        ax.pcolormesh(x, y, density, cmap="Oranges", vmin=0.0, vmax=posterior.max(),
                      shading="auto", rasterized=True)  # fmt: skip
        ax.plot(
            [lower[0], upper[0], upper[0], lower[0], lower[0]],
            [lower[1], lower[1], upper[1], upper[1], lower[1]],
            color=BOUNDS,
        )
        _ellipses(ax, np.zeros(2), _PLANE_COV[:2, :2], TRUTH, "-")
        if k == 2:
            _ellipses(ax, mean[:2], cov[:2, :2], _MATCHED, "--")
        ax.set(xlabel="z₁", xlim=(-3.0, 3.0), ylim=(-3.0, 3.0))
        ax.set_aspect("equal")
        ax.grid(False)
        set_title(ax, titles[k])
    axes[0].set_ylabel("z₂")


def _ellipses(ax: Axes, mean, cov, color: str, style: str) -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    circle = np.linalg.cholesky(cov) @ np.array([np.cos(angle), np.sin(angle)])
    for size in (1.0, 2.0):
        ax.plot(*(mean[:, None] + size * circle), style, color=color, linewidth=1.4)
    ax.plot(*mean, "x", color=color)


def _density(z: np.ndarray, mean: float, variance: float) -> np.ndarray:
    return np.exp(-0.5 * (z - mean) ** 2 / variance) / np.sqrt(2.0 * np.pi * variance)


def _density_2d(x: np.ndarray, y: np.ndarray, mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
    d = np.stack([x - mean[0], y - mean[1]], axis=-1)
    distance = np.einsum("...i,ij,...j->...", d, np.linalg.inv(cov), d)
    return np.exp(-0.5 * distance) / (2.0 * np.pi * np.sqrt(np.linalg.det(cov)))
