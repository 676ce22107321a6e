"""Figures of the observer's errors: distribution, coverage of the bounds, mixing."""

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import norm

from surefoot.models.calibration.mixing import Mixing
from surefoot.scenarios.reporting.figures import NAMED_AXES
from surefoot.scenarios.reporting.palette import BOUNDS, INK, OUTSIDE, TEST, TRAIN
from surefoot.scenarios.reporting.plotting import legend_below, new_figure, set_title


def error_distributions(
    train: np.ndarray,
    test: np.ndarray,
    epsilon: np.ndarray,
    gamma: float,
    title: str = "Observer's velocity errors on its training walk and on another one",
) -> Figure:
    """Histograms with fitted Gaussians and the bounds, and quantile-quantile plots below.

    The paper's figure "errors_motivation": an error that is Gaussian in training need not be so
    elsewhere.

    Args:
        train: errors (N, 3) in I, m/s, on the observer's training walk.
        test: errors (M, 3) in I, m/s, on another walk.
        epsilon: (3,) m/s, calibrated half widths.
        gamma: joint level of the bounds.
        title: of the figure.
    """
    figure, axes = new_figure(2, 3, size=(9.5, 5.8), ratios=[1.25, 1.0])
    sets = (("Training", train, TRAIN), ("Test", test, TEST))
    for k, (axis, word) in enumerate(NAMED_AXES):
        top, below = axes[0, k], axes[1, k]
        edge = 1.15 * max(
            epsilon[k], *[float(np.quantile(np.abs(e[:, k]), 0.998)) for _, e, _ in sets]
        )
        bins = np.linspace(-edge, edge, 61).tolist()
        grid = np.linspace(-edge, edge, 400)
        top.axvspan(-epsilon[k], epsilon[k], color=BOUNDS, alpha=0.18, label="Bounds |e| ≤ ε")
        shares = []
        for name, errors, color in sets:
            e = errors[:, k]
            top.hist(e, bins=bins, density=True, color=color, alpha=0.45, label=f"{name} errors")
            fit = norm.pdf(grid, e.mean(), e.std())
            top.plot(
                grid,
                fit,
                color=color,
                linewidth=1.6,
                linestyle="--",
                label=f"Gaussian fit, {name.lower()}",
            )
            shares.append(f"{name.lower()} {100 * (np.abs(e) <= epsilon[k]).mean():.1f} %")
            _quantiles(below, e, color, name)
        for sign in (-1, 1):
            top.axvline(sign * epsilon[k], color=BOUNDS, linewidth=1.2)
        top.set_title(
            f"{axis} ({word}), ε = {epsilon[k]:.3g} m/s\ninside: {', '.join(shares)}", fontsize=9
        )
        top.set(xlabel="error [m/s]", xlim=(-edge, edge), yticks=[])
        below.plot([-4, 4], [-4, 4], color=INK, linewidth=0.8)
        below.set(xlabel="Gaussian quantile [σ]", xlim=(-4, 4), ylim=(-7, 7))
    axes[0, 0].set_ylabel("density")
    axes[1, 0].set_ylabel("error's quantile [σ]\n(on the line: Gaussian)")
    joint = ", ".join(
        f"{name.lower()} {100 * (np.abs(e) <= epsilon).all(axis=1).mean():.1f} %"
        for name, e, _ in sets
    )
    figure.suptitle(
        f"{title}\nAll three axes inside at once: {joint}; meant: at least {100 * gamma:g} %",
        x=0.01,
        ha="left",
        fontsize=11,
    )
    legend_below(figure, axes[0, 0], columns=5)
    return figure


def error_bounds(
    train: np.ndarray,
    test: np.ndarray,
    epsilon: np.ndarray,
    gamma: float,
    title: str = "One bound for the errors in training and on another walk",
) -> Figure:
    """The paper's figure "coverage_validity": the share of errors below each size, and the bound.

    A bound holds where the curve crosses it above gamma^(1/3).

    Args:
        train: (N, 3) [m/s] in I, errors in training.
        test: (M, 3) [m/s] in I, on another walk.
        epsilon: (3,) [m/s], the bounds.
        gamma: their joint level.
        title: of the figure.
    """
    figure, axes = new_figure(1, 3, size=(9.5, 3.4))
    level = gamma ** (1 / 3)
    for k, (axis, word) in enumerate(NAMED_AXES):
        ax = axes[0, k]
        edge = max(1.6 * epsilon[k], *[np.quantile(np.abs(e[:, k]), 0.995) for e in (train, test)])
        ax.axvspan(0, epsilon[k], color=BOUNDS, alpha=0.18, label="Bounds |e| ≤ ε")
        ax.axhline(100 * level, color=INK, linewidth=1.0, linestyle=":", label="level of each axis")
        shares = []
        for name, e, color, line in (("Training", train, TRAIN, "-"), ("Test", test, TEST, "--")):
            sizes = np.sort(np.abs(e[:, k]))
            share = 100 * np.arange(1, len(sizes) + 1) / len(sizes)
            ax.plot(
                sizes, share, color=color, linestyle=line, linewidth=1.9, label=f"{name} errors"
            )
            shares.append(f"{name.lower()} {100 * (sizes <= epsilon[k]).mean():.1f} %")
        ax.set_title(
            f"{axis} ({word}), ε = {epsilon[k]:.3g} m/s\ninside: {', '.join(shares)}", fontsize=9
        )
        ax.set(xlabel="|error| [m/s]", xlim=(0, edge), ylim=(0, 101))
        ax.locator_params(axis="x", nbins=5)  # more would touch
    axes[0, 0].set_ylabel("errors that are smaller [%]")
    figure.suptitle(title, x=0.01, ha="left", fontsize=11)
    legend_below(figure, axes[0, 0])
    return figure


def mixing_curve(
    mixing: Mixing,
    rate: float = 100.0,
    title: str = "β-mixing coefficient of the observer's errors",
) -> Figure:
    """The beta-mixing coefficient of each axis over the lag, with the spacing K marked.

    Bold lines are the excess over the estimator's floor, from which K is determined; pale ones are
    the raw histogram estimate. `rate` [Hz] is that of the samples.
    """
    figure, axes = new_figure(size=(7.0, 4.4))
    ax = axes[0, 0]
    for k, (axis, word) in enumerate(NAMED_AXES):
        style = ("-", "--", ":")[k]
        ax.plot(mixing.lags, mixing.beta[:, k], color="#BDBDBD", linestyle=style, linewidth=1.0)
        ax.plot(
            mixing.lags,
            mixing.excess[:, k],
            color=INK,
            linestyle=style,
            linewidth=1.9,
            label=f"{axis} ({word})",
        )
    ax.plot([], [], color="#BDBDBD", linewidth=1.0, label="before subtracting the floor")
    level = mixing.threshold
    ax.axhline(level, color=BOUNDS, linewidth=1.2, linestyle=(0, (4, 2)), label=f"β = {level:g}")
    delay = f"{1e3 * mixing.K / rate:g} ms"
    ax.axvline(mixing.K, color=OUTSIDE, linewidth=1.4, label=f"K = {mixing.K} ({delay})")
    ax.set(xlabel=f"lag [samples of {1e3 / rate:g} ms]", ylabel="β(lag)", ylim=(0, None))
    ax.set_xlim(0, mixing.lags[-1])
    set_title(ax, title if mixing.mixed else f"{title}\n(does not come down to {level:g})")
    legend_below(figure, ax, columns=3)
    return figure


def _quantiles(ax, e: np.ndarray, color: str, name: str) -> None:
    levels = norm.cdf(np.linspace(-3.5, 3.5, 141))
    standard = (np.quantile(e, levels) - e.mean()) / e.std()
    ax.plot(norm.ppf(levels), standard, color=color, linewidth=2.0, label=name)
