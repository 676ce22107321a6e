"""Figures of a realism card: the measured walk and the simulated ones in the same axes."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from surefoot.models.realism import quantities
from surefoot.models.realism.walk_view import WalkView
from surefoot.scenarios.reporting.html import Picture
from surefoot.scenarios.reporting.palette import AFTER, BEFORE, INK, OUTSIDE
from surefoot.scenarios.reporting.plotting import legend_below, new_figure, set_title, single_axes

PHASES = 20
"""Bins of the phase of stance."""
_COLORS = (BEFORE, AFTER)
Walks = Sequence[tuple[str, str, Sequence[WalkView]]]
"""Label, colour and walks of each robot."""


def pictures(measured: WalkView, simulated: Mapping[str, Sequence[WalkView]]) -> Iterator[Picture]:
    """The card's figures with their captions; walks of each simulated robot by its name."""
    walks: Walks = [("measured", OUTSIDE, [measured])]
    for k, (words, group) in enumerate(simulated.items()):
        walks = [*walks, (f"simulated, {words}", _COLORS[k % 2], group)]
    yield Picture(
        _standing_speed(walks),
        "Speed over the ground of feet that are sensed to stand, by the declared legs, median by "
        "phase of stance with its middle half. It is zero for rigid legs on feet that stand still.",
    )
    if all(w.log.has("force") for _, _, group in walks for w in group):
        yield Picture(
            _force(walks), "Foot force over the median of its stance's middle, by phase of stance."
        )
    yield Picture(_spectra(walks), "Power spectral density of the IMU, all axes together.")


def _standing_speed(walks: Walks) -> Figure:
    figure, axes = new_figure(1, 3, size=(11.0, 3.6))
    for a, ax in enumerate(axes[0]):
        for label, color, group in walks:
            phase = np.concatenate([w.phase.ravel() for w in group])
            outward = [w.outward if a == 1 else 1.0 for w in group]
            moving = zip((w.standing_velocity[..., a] for w in group), outward, strict=True)
            speed = np.concatenate([(velocity * sign).ravel() for velocity, sign in moving])
            _band(ax, phase, speed, label, color)
        ax.axhline(0.0, color=INK, linewidth=0.8)
        ax.set(xlabel="phase of stance", ylabel="m/s")
        set_title(ax, quantities.DIRECTIONS_OF_FEET[a])
    legend_below(figure, axes[0, 0])
    return figure


def _band(ax, phase: np.ndarray, values: np.ndarray, label: str, color: str) -> None:
    """Plot median and middle half of values by phase of stance.

    Args:
        ax: to draw on.
        phase: (N,), NaN in the air.
        values: (N,).
        label: of the legend.
        color: of line and band.
    """
    known = np.isfinite(phase) & np.isfinite(values)
    bins = np.minimum((phase[known] * PHASES).astype(int), PHASES - 1)
    parts = [values[known][bins == k] for k in range(PHASES)]
    middle = (np.arange(PHASES) + 0.5) / PHASES
    low, median, high = np.array(
        [np.percentile(p, (25, 50, 75)) if len(p) else (np.nan,) * 3 for p in parts]
    ).T
    ax.plot(middle, median, color=color, label=label)
    ax.fill_between(middle, low, high, color=color, alpha=0.2, linewidth=0)


def _force(walks: Walks) -> Figure:
    figure, ax = single_axes(7.5, 3.6)
    for label, color, group in walks:
        phase, force = [], []
        for w in group:
            scaled = w.log.force.copy()
            middle = (w.phase > 0.25) & (w.phase < 0.75) & w.walks[:, None]
            scaled /= np.nanmedian(np.where(middle, scaled, np.nan), axis=0)
            phase.append(np.where(w.walks[:, None], w.phase, np.nan).ravel())
            force.append(scaled.ravel())
        _band(ax, np.concatenate(phase), np.concatenate(force), label, color)
    ax.set(xlabel="phase of stance", ylabel="force / its middle")
    legend_below(figure, ax)
    return figure


def _spectra(walks: Walks) -> Figure:
    figure, axes = new_figure(1, 2, size=(11.0, 3.8))
    units = {"accel": "(m/s^2)^2/Hz", "gyro": "(rad/s)^2/Hz"}
    for ax, (sensor, unit) in zip(axes[0], units.items(), strict=True):
        for label, color, group in walks:
            density = np.concatenate([quantities.spectra(w, sensor)[0] for w in group]).mean(axis=0)
            ax.loglog(quantities.FREQUENCIES, density, color=color, label=label)
        ax.set(xlabel="Hz", ylabel=unit)
        set_title(ax, {"accel": "accelerometer", "gyro": "gyro"}[sensor])
    legend_below(figure, axes[0, 0])
    return figure
