"""Errors of an observer in training and elsewhere: statistics, description and figures."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import norm

from surefoot.models.calibration.error_statistics import ErrorStatistics, error_statistics
from surefoot.models.calibration.mixing import Mixing
from surefoot.models.observer.samples import RATE
from surefoot.scenarios.estimate.error_series import NAMED_AXES
from surefoot.scenarios.reporting.html import Picture, Section
from surefoot.scenarios.reporting.palette import BOUNDS, INK, OUTSIDE, TEST, TRAIN
from surefoot.scenarios.reporting.plotting import (
    label_decades,
    legend_below,
    new_figure,
    set_title,
    single_axes,
)
from surefoot.sim.common.errors import SurefootError

LEVEL = 0.01
"""Significance level at which normality is rejected."""


def error_section(
    train: np.ndarray, test: np.ndarray, epsilon: np.ndarray, gamma: float, where: str = "test"
) -> Section:
    """Section of a report on errors in training and on another log.

    It says so where either has too few independent errors.

    Args:
        train: (N, 3) [m/s] in I, stored with every observer: Observer.errors.
        test: (M, 3) [m/s] in I.
        epsilon: (3,) [m/s], the bounds.
        gamma: their joint level.
        where: name of the test log.
    """
    try:
        of_train, of_test = error_statistics(train), error_statistics(test)
    except SurefootError as error:  # too few to test, not too few to cover
        return Section("The observer's errors", str(error))
    rows = [*error_table(of_train, "training"), *error_table(of_test, where)]
    shares = [100 * float((np.abs(e) <= epsilon).all(axis=1).mean()) for e in (train, test)]
    x, y, z = epsilon
    words = (
        f"The bound |error| <= {x:.3f}, {y:.3f}, {z:.3f} m/s on all axes at once, meant for "
        f"{100 * gamma:g} %, holds for {shares[0]:.1f} % of the errors in training and for "
        f"{shares[1]:.1f} % on {where}.\n\nShape and bias are of errors far enough apart to be "
        f"independent. A Gaussian is rejected at p < {LEVEL:g} (D'Agostino and Pearson); with few "
        "errors a departure from it may go undetected."
    )
    pictures = (
        Picture(
            error_distributions(train, test, epsilon, gamma),
            "Errors in training (blue) and elsewhere (red), and the Gaussian fitted to each.",
            "figures/observer_errors_1.png",
        ),
        Picture(
            error_bounds(train, test, epsilon, gamma),
            "One bound for both: the share of errors that are smaller than the value below.",
            "figures/observer_errors_2.png",
        ),
    )
    return Section(f"The observer's errors: training and {where}", words, rows, pictures)


def error_table(found: ErrorStatistics, where: str) -> list[dict[str, object]]:
    """One row per axis."""
    return [
        {
            "errors": where,
            "axis": word,
            "bias [m/s]": f"{found.mean[k]:+.4f} ± {found.half_width[k]:.4f}",
            "std [m/s]": found.std[k],
            "skewness": found.skewness[k],
            "excess kurtosis": found.kurtosis[k],
            "beyond 3 std [%]": 100 * found.beyond[k],
            "p of a Gaussian": found.normal_p[k],
            "a Gaussian is": "rejected" if found.normal_p[k] < LEVEL else "not rejected",
            "independent": found.independent,
        }
        for k, (_, word) in enumerate(NAMED_AXES)
    ]


def error_distributions(
    train: np.ndarray, test: np.ndarray, epsilon: np.ndarray, gamma: float
) -> Figure:
    """Histograms with fitted Gaussians and the bounds, and quantile-quantile plots below.

    The paper's figure "errors_motivation": an error that is Gaussian in training need not be so
    elsewhere.

    Args:
        train: errors (N, 3) in I, m/s, on the observer's training walk.
        test: errors (M, 3) in I, m/s, on another walk.
        epsilon: (3,) m/s, calibrated half widths.
        gamma: joint level of the bounds.
    """
    sets = (("Training", train, TRAIN), ("Test", test, TEST))
    joint = ", ".join(
        f"{name.lower()} {100 * (np.abs(e) <= epsilon).all(axis=1).mean():.1f} %"
        for name, e, _ in sets
    )
    title = (
        "Observer's velocity errors on its training walk and on another one\n"
        f"All three axes inside at once: {joint}; meant: at least {100 * gamma:g} %"
    )
    figure, axes = new_figure(2, 3, size=(9.5, 5.8), ratios=[1.25, 1.0], title=title)
    for k in range(3):
        top, below = axes[0, k], axes[1, k]
        largest = [float(np.quantile(np.abs(e[:, k]), 0.998)) for _, e, _ in sets]
        edge = 1.15 * max(epsilon[k], *largest)
        bins = np.linspace(-edge, edge, 61).tolist()
        grid = np.linspace(-edge, edge, 400)
        top.axvspan(-epsilon[k], epsilon[k], color=BOUNDS, alpha=0.18, label="Bounds |e| ≤ ε")
        for name, errors, color in sets:
            e = errors[:, k]
            top.hist(e, bins=bins, density=True, color=color, alpha=0.45, label=f"{name} errors")
            fit = norm.pdf(grid, e.mean(), e.std())
            label = f"Gaussian fit, {name.lower()}"
            top.plot(grid, fit, "--", color=color, linewidth=1.6, label=label)
            _quantiles(below, e, color, name)
        for sign in (-1, 1):
            top.axvline(sign * epsilon[k], color=BOUNDS, linewidth=1.2)
        _title_axis(top, k, epsilon, train, test)
        top.set(xlabel="error [m/s]", xlim=(-edge, edge), yticks=[])
        below.plot([-4, 4], [-4, 4], color=INK, linewidth=0.8)
        below.set(xlabel="Gaussian quantile [σ]", xlim=(-4, 4), ylim=(-7, 7))
    axes[0, 0].set_ylabel("density")
    axes[1, 0].set_ylabel("error's quantile [σ]\n(on the line: Gaussian)")
    legend_below(figure, axes[0, 0], columns=5)
    return figure


def error_bounds(train: np.ndarray, test: np.ndarray, epsilon: np.ndarray, gamma: float) -> Figure:
    """The paper's figure "coverage_validity": the share of errors below each size, and the bound.

    A bound holds where the curve crosses it above gamma^(1/3).

    Args:
        train: (N, 3) [m/s] in I, errors in training.
        test: (M, 3) [m/s] in I, on another walk.
        epsilon: (3,) [m/s], the bounds.
        gamma: their joint level.
    """
    title = "One bound for the errors in training and on another walk"
    figure, axes = new_figure(1, 3, size=(9.5, 3.4), title=title)
    level = gamma ** (1 / 3)
    for k in range(3):
        ax = axes[0, k]
        edge = max(1.6 * epsilon[k], *[np.quantile(np.abs(e[:, k]), 0.995) for e in (train, test)])
        ax.axvspan(0, epsilon[k], color=BOUNDS, alpha=0.18, label="Bounds |e| ≤ ε")
        ax.axhline(100 * level, color=INK, linewidth=1.0, linestyle=":", label="level of each axis")
        for name, e, color, line in (("Training", train, TRAIN, "-"), ("Test", test, TEST, "--")):
            sizes = np.sort(np.abs(e[:, k]))
            share = 100 * np.arange(1, len(sizes) + 1) / len(sizes)
            ax.plot(sizes, share, line, color=color, linewidth=1.9, label=f"{name} errors")
        _title_axis(ax, k, epsilon, train, test)
        ax.set(xlabel="|error| [m/s]", xlim=(0, edge), ylim=(0, 101))
        ax.locator_params(axis="x", nbins=5)  # more would touch
    axes[0, 0].set_ylabel("errors that are smaller [%]")
    legend_below(figure, axes[0, 0])
    return figure


def error_by_number(errors: Mapping[str, Mapping[int, float | Sequence[float]]]) -> Figure:
    """Errors [m/s], one or several of each, by the observers' inputs and the number of walks."""
    figure, ax = single_axes(6.0, 3.5)
    for inputs, found in errors.items():
        values = [np.atleast_1d(one) for one in found.values()]
        (line,) = ax.plot(list(found), [one.mean() for one in values], "o-", label=inputs)
        for count, each in zip(found, values, strict=True):
            ax.plot([count] * len(each), each, ".", color=line.get_color(), alpha=0.5)
    ax.set_xscale("log", base=2)
    ax.set_yscale("log")
    counts = sorted({count for found in errors.values() for count in found})
    ax.set_xticks(counts, [str(count) for count in counts])
    label_decades(ax.yaxis)
    ax.set_xlabel("walks to train on")
    ax.set_ylabel("velocity RMSE [m/s]")
    ax.legend(frameon=False)
    return figure


def mixing_curve(mixing: Mixing) -> Figure:
    """The beta-mixing coefficient of each axis over the lag, with the spacing K marked.

    Bold lines are the excess over the estimator's floor, from which K is determined; pale ones are
    the raw histogram estimate.
    """
    figure, ax = single_axes(7.0, 4.4)
    for k, (axis, word) in enumerate(NAMED_AXES):
        style, label = ("-", "--", ":")[k], f"{axis} ({word})"
        ax.plot(mixing.lags, mixing.beta[:, k], style, color="#BDBDBD", linewidth=1.0)
        ax.plot(mixing.lags, mixing.excess[:, k], style, color=INK, linewidth=1.9, label=label)
    ax.plot([], [], color="#BDBDBD", linewidth=1.0, label="before subtracting the floor")
    level = mixing.threshold
    ax.axhline(level, color=BOUNDS, linewidth=1.2, linestyle=(0, (4, 2)), label=f"β = {level:g}")
    delay = f"{1e3 * mixing.K / RATE:g} ms"
    ax.axvline(mixing.K, color=OUTSIDE, linewidth=1.4, label=f"K = {mixing.K} ({delay})")
    ax.set(xlabel=f"lag [samples of {1e3 / RATE:g} ms]", ylabel="β(lag)", ylim=(0, None))
    ax.set_xlim(0, mixing.lags[-1])
    unmixed = "" if mixing.mixed else f"\n(does not come down to {level:g})"
    set_title(ax, f"β-mixing coefficient of the observer's errors{unmixed}")
    legend_below(figure, ax, columns=3)
    return figure


def _title_axis(ax, k: int, epsilon: np.ndarray, train: np.ndarray, test: np.ndarray) -> None:
    axis, word = NAMED_AXES[k]
    a, b = (100 * (np.abs(errors[:, k]) <= epsilon[k]).mean() for errors in (train, test))
    inside = f"inside: training {a:.1f} %, test {b:.1f} %"
    ax.set_title(f"{axis} ({word}), ε = {epsilon[k]:.3g} m/s\n{inside}", fontsize=9)


def _quantiles(ax, e: np.ndarray, color: str, name: str) -> None:
    levels = norm.cdf(np.linspace(-3.5, 3.5, 141))
    standard = (np.quantile(e, levels) - e.mean()) / e.std()
    ax.plot(norm.ppf(levels), standard, color=color, linewidth=2.0, label=name)
