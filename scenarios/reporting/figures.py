"""Figures of one walk: path, height, velocity, and the error of each estimator."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from surefoot.models.observer.samples import body_velocity
from surefoot.scenarios.estimate.error_series import NAMED_AXES, QUANTITIES, ErrorSeries
from surefoot.scenarios.reporting.palette import (
    BOUNDS,
    INK,
    OBSERVER,
    OUTSIDE,
    TRUTH,
    estimator_color,
    estimator_look,
    friction_color,
)
from surefoot.scenarios.reporting.plotting import (
    WHITE_BOX,
    legend_below,
    limit_to_errors,
    new_figure,
    set_title,
    show_time,
    show_to_scale,
    single_axes,
)
from surefoot.sim.ground.ground_metadata import ground_of_log
from surefoot.sim.ground.terrain import HeightField
from surefoot.sim.log import Log

if TYPE_CHECKING:
    from surefoot.models.observer.predict import Prediction

_HILLS = "#A9A08C"  # of contour lines, as of the ground in recordings


def trajectories(log: Log, errors: Mapping[str, ErrorSeries]) -> Figure:
    """Truth and estimates in the ground plane, with start and end marks and, where the log has
    them, slippery patches and contour lines of the ground.

    Args:
        log: the walk, with a reference.
        errors: estimator name -> its aligned path
            (surefoot.scenarios.estimate.error_series.error_series).
    """
    everywhere = np.concatenate([log.ref_p[:, :2], *[e.p_GI[:, :2] for e in errors.values()]])
    span = np.maximum(np.ptp(everywhere, axis=0), 1.0)
    width = 7.5
    height = float(np.clip(width * (span[1] + 0.1) / (span[0] + 0.1), 3.0, 7.5)) + 1.0
    figure, ax = single_axes(width, height)
    margin = 0.06 * span.max()
    low, high = everywhere.min(axis=0) - margin, everywhere.max(axis=0) + margin
    if ground := ground_of_log(log):
        for field in ground.fields:
            _draw_contours(ax, field)
        for patch in ground.patches:
            _draw_patch(ax, patch, low, high)
    x, y, _ = log.ref_p.T
    ax.plot(x, y, color=TRUTH, linewidth=3.5, label=_known(log), solid_capstyle="round")
    for name, error in errors.items():
        look = estimator_look(name, f"{error.distance[-1]:.2f} m off at the end")
        there_x, there_y, _ = error.p_GI.T
        ax.plot(there_x, there_y, linewidth=1.4, **look)
        ends = ax.plot(there_x[-1], there_y[-1], "X", color=look["color"])
        ends[0].set(markersize=8, markeredgecolor="white")
    ax.plot(x[0], y[0], "o", color=INK, markersize=8, label="Start")
    ax.plot(x[-1], y[-1], "s", color=INK, markersize=7, label=f"{_known(log)}'s end")
    ax.plot([], [], "X", color=INK, markersize=7, label="Estimated end")
    ax.set(xlabel="x [m]", ylabel="y [m]")
    show_to_scale(ax, low, high)
    set_title(ax, "Path seen from above")
    legend_below(figure, ax, columns=2)
    return figure


def height_figure(log: Log, errors: Mapping[str, ErrorSeries]) -> Figure:
    """Height of truth and estimates over time, whose drift is unobservable."""
    figure, ax = single_axes(7.5, 3.6)
    t, z = log.t, log.ref_p[:, 2]
    ax.plot(t, z, color=TRUTH, linewidth=3.0, label=_known(log))
    for name, error in errors.items():
        look = estimator_look(name, f"{error.position[-1, 2]:+.3f} m at the end")
        ax.plot(error.t, error.p_GI[:, 2], **look)
    ax.set_ylabel("height z [m]")
    show_time(ax, t[0], t[-1])
    set_title(ax, "Height of the IMU over time")
    legend_below(figure, ax, columns=2)
    return figure


def _known(log: Log) -> str:
    """What a log's reference is: the truth only where it is simulated."""
    return "Reference" if log.meta.seed is None else "Truth"


def velocity_figure(log: Log, prediction: "Prediction", epsilon: np.ndarray) -> Figure:
    """True and predicted velocity of the IMU in its own axes, one panel per axis.

    Of a long walk, the middle ten seconds are shown; the shares in the panel titles are of the
    whole walk.

    Args:
        log: the walk, with a reference.
        prediction: an observer's rows (M,) of the log and v_I (M, 3) m/s there.
        epsilon: half widths of the bounds, (3,) or (M, 3) m/s.
    """
    rows = np.asarray(prediction.rows)
    t, (truth, ok) = log.t[rows], body_velocity(log, rows)
    predicted = np.asarray(prediction.v_I)
    half = np.broadcast_to(epsilon, predicted.shape)
    first, last, when = t[0], t[-1], ""
    if last - first > 15.0:
        first, last = 0.5 * (first + last) - 5.0, 0.5 * (first + last) + 5.0
        when = f", {first:.0f} to {last:.0f} s"
    shown = (t >= first) & (t <= last)
    title = f"Body velocity: {_known(log).lower()}, observer and its bounds{when}"
    figure, axes = new_figure(3, 1, size=(7.5, 6.2), share_x=True, title=title)
    for k, (axis, word) in enumerate(NAMED_AXES):
        ax = axes[k, 0]
        lower, upper = predicted[:, k] - half[:, k], predicted[:, k] + half[:, k]
        band = ax.fill_between(t[shown], lower[shown], upper[shown], color=BOUNDS, linewidth=0)
        band.set(alpha=0.25, label="Observer ± ε (the bounds)")
        ax.plot(t[shown], predicted[shown, k], color=OBSERVER, linewidth=1.2, label="Observer")
        measured = np.where(ok, truth[:, k], np.nan)
        ax.plot(t[shown], measured[shown], color=TRUTH, linewidth=2.0, label=_known(log))
        outside = ok & (np.abs(truth[:, k] - predicted[:, k]) > half[:, k])
        missed = t[shown & outside], truth[shown & outside, k]
        ax.plot(*missed, ".", color=OUTSIDE, markersize=4, label=f"{_known(log)} outside")
        inside = f"{100.0 * (1.0 - outside[ok].mean()):.1f} % of the walk inside"
        set_title(
            ax, f"{axis} of the IMU ({word}): {inside} ± {np.median(half[:, k]):.3g} m/s", 9.5
        )
        ax.set_ylabel("m/s")
    show_time(axes[-1, 0], first, last)
    legend_below(figure, axes[0, 0])
    return figure


def position_error(errors: Mapping[str, ErrorSeries]) -> Figure:
    """Position error norm and the filter's own 3 sigma (of the covariance's trace) over time."""
    figure, ax = single_axes(7.5, 4.0)
    top = 0.0
    for name, error in errors.items():
        sigma, note = error.distance_sigma, ""
        if sigma is not None:
            note = f"{100.0 * (error.distance <= 3.0 * sigma).mean():.0f} % within 3σ"
        draw_error(ax, estimator_look(name, note), error.t, error.distance, sigma)
        top = max(top, float(error.distance.max()))
    show_time(ax, *_span(errors))
    ax.set_ylabel("position error [m]")
    limit_to_errors(ax, top)
    set_title(ax, "Position error, and each filter's own 3σ (thin)")
    legend_below(figure, ax, columns=2)
    return figure


def draw_error(ax: Axes, look: dict[str, Any], t, distance, sigma=None) -> None:
    """Draw the distance from the truth (N,) [m] over t [s], and thin the filter's own 3 sigma."""
    ax.plot(t, distance, linewidth=1.8, **look)
    if sigma is not None:
        ax.plot(t, 3.0 * sigma, linewidth=0.7, **dict(look, label="_"))


def errors_by_axis(errors: Mapping[str, ErrorSeries]) -> Figure:
    """Errors of position in G, attitude about the heading's axes, and velocity in I, one panel for
    each axis, with the filter's own 3 sigma as a band.
    """
    title = "Errors by axis, and each filter's own 3σ (shaded)"
    figure, axes = new_figure(3, 3, size=(10.0, 6.5), share_x=True, title=title)
    for column, (field, words, names, factor) in enumerate(QUANTITIES):
        for k, axis in enumerate(names):
            ax, most = axes[k, column], 0.0
            for name, series in errors.items():
                error, sigma = getattr(series, field), getattr(series, f"{field}_sigma")
                ax.plot(series.t, factor * error[:, k], linewidth=1.2, **estimator_look(name))
                most = max(most, float(np.abs(factor * error[:, k]).max()))
                if sigma is not None:
                    band, color = 3.0 * factor * sigma[:, k], estimator_color(name)
                    shown = ax.fill_between(series.t, -band, band, color=color, zorder=0.5)
                    shown.set(alpha=0.08, linewidth=0)
                    edges = np.stack([-band, band], axis=1)
                    ax.plot(series.t, edges, color=color, linewidth=0.4)
            ax.set_ylim(*np.clip(ax.get_ylim(), -6.0 * most, 6.0 * most) if most else (-1.0, 1.0))
            set_title(ax, f"{words.partition(' [')[0]}, {axis}", 9.0)
            ax.set_ylabel(words.partition(" ")[2].strip("[]"))
    for ax in axes[-1]:
        show_time(ax, *_span(errors))
    legend_below(figure, axes[0, 0])
    return figure


def _span(errors: Mapping[str, ErrorSeries]) -> tuple[float, float]:
    """First and last stamp of these errors [s]."""
    ends = [(e.t[0], e.t[-1]) for e in errors.values()] or [(0.0, 1.0)]
    return min(first for first, _ in ends), max(last for _, last in ends)


def _draw_contours(ax, field: HeightField) -> None:
    """Draw the boundary of a height field and six contour lines."""
    x0, x1, y0, y1 = field.rectangle
    edge = Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, edgecolor=_HILLS, linewidth=0.6)
    edge.set_zorder(0.4)
    ax.add_patch(edge)
    if np.ptp(field.heights) > 0.0:
        nx, ny = field.heights.shape
        x, y = np.linspace(x0, x1, nx), np.linspace(y0, y1, ny)
        ax.contour(x, y, field.heights.T, levels=6, colors=_HILLS, linewidths=0.6, zorder=0.4)


def _draw_patch(ax, patch, low: np.ndarray, high: np.ndarray) -> None:
    """Draw a patch as a coloured, hatched rectangle, labelled with its friction if there is
    room.
    """
    centre = np.array([patch.center_x, patch.center_y])
    size = np.array([patch.size_x, patch.size_y])
    drawn = Rectangle(tuple(centre - 0.5 * size), *size, rotation_point="center")
    drawn.set(angle=np.degrees(getattr(patch, "yaw", 0.0)), zorder=0.5, alpha=0.7, linewidth=0.8)
    drawn.set(facecolor=friction_color(patch.mu), edgecolor="#7FB5CC", hatch="///")
    ax.add_patch(drawn)
    if (centre > low).all() and (centre < high).all():
        place = centre[0], min(centre[1] + 0.5 * size[1], high[1])
        label = ax.annotate(f"friction {patch.mu:.2f}", place, fontsize=8, bbox=WHITE_BOX)
        label.set(ha="center", va="top", color="#33677D")
