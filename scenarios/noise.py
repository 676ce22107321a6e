"""`surefoot noise`: estimate sensor noise at rest, as settings for the filters."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from surefoot.models.noise import AxisNoise, Density, RestNoise, rest_noise
from surefoot.scenarios.reporting.plotting import legend_below, new_figure, save_figure, set_title
from surefoot.scenarios.reporting.tables import to_markdown
from surefoot.sim.common.files import refuse_overwrite, whole_file
from surefoot.sim.log import Log

COLORS = ("#D55E00", "#009E73", "#2F86D1")
SENSORS = (("gyro", "rad/s", "rad/s²"), ("accel", "m/s²", "m/s³"))
"""Each sensor, its unit, and the unit of its derivative."""


def noise(log: Log, out: Path | None, force: bool = False) -> RestNoise:
    """Estimate the noise of a log at rest and, with `out`, write settings and a figure.

    out: TOML file of `surefoot.scenarios.estimate.settings`; a .png of the same name is written
    beside it. Raises SurefootError where the log never rests, or a file exists and `force` is not
    given.
    """
    outputs = () if out is None else (out, out.with_suffix(".png"))
    for path in outputs:
        refuse_overwrite(path, force)
    found = rest_noise(log)
    if outputs:
        settings, figure = outputs
        with whole_file(settings, force) as temporary:
            temporary.write_text(settings_text(log.name, found), encoding="utf-8")
            save_figure(allan_figure(found), figure, force)
    return found


def noise_text(name: str, found: RestNoise) -> str:
    """The noise of the log of that name, as a table."""
    rows = [
        {
            "sensor": f"{sensor} {axis}",
            "white noise": f"{one.white.value:.2e}",
            "95 % interval": _interval(one.white),
            "unit": f"{unit}/√Hz",
            "bias random walk": f"{one.walk.value:.2e}" if one.walk.resolved else "rest too short",
            "95 % interval ": _interval(one.walk),
            "unit ": f"{rate}/√Hz",
        }
        for sensor, unit, rate in SENSORS
        for axis, one in zip("xyz", getattr(found, sensor), strict=True)
    ]
    return f"{name}: at rest from {found.begin:.2f} to {found.end:.2f} s\n\n{to_markdown(rows)}"


def settings_text(name: str, found: RestNoise) -> str:
    """The worst axis of each sensor as settings; values that need a longer rest are comments."""
    lines = [
        f"# Noise of {name} at rest from {found.begin:.2f} to {found.end:.2f} s: the worst axis.",
        "# While walking, impacts and misalignment add to it, so filters need larger values.",
        "[noise]",
    ]
    for sensor, unit, rate in SENSORS:
        axes: tuple[AxisNoise, ...] = getattr(found, sensor)
        for key, kind, own in ((sensor, "white", unit), (f"{sensor}_walk", "walk", rate)):
            each: list[Density] = [getattr(one, kind) for one in axes]
            worst = max(each, key=lambda one: one.value)
            words = f"{own.replace('²', '^2').replace('³', '^3')}/sqrt(Hz)"
            if worst.resolved:
                interval = f"95 % interval {_interval(worst)}"
                lines.append(f"{key} = {worst.value:.3g}  # {words}, {interval}")
            else:
                limit = max(one.high for one in each)
                lines.append(f"# {key} is below {limit:.2g} {words}: the rest is too short to tell")
    return "\n".join(lines) + "\n"


def allan_figure(found: RestNoise) -> Figure:
    """Plot the Allan deviations of gyro and accelerometer with the fits."""
    figure, axes = new_figure(1, 2, (8.0, 3.6))
    for ax, (name, unit, _) in zip(axes[0], SENSORS, strict=True):
        for one, axis, color in zip(getattr(found, name), "xyz", COLORS, strict=True):
            tau = one.curve.tau
            fitted = np.sqrt(one.white.value**2 / tau + one.walk.value**2 * tau / 3.0)
            spread = one.curve.sigma / np.sqrt(2.0 * one.curve.freedom)
            ax.errorbar(tau, one.curve.sigma, 1.96 * spread, fmt=".", color=color, label=axis)
            ax.plot(tau, fitted, color=color)
        ax.set(xscale="log", yscale="log", xlabel="averaging time [s]")
        ax.set_ylabel(f"Allan deviation [{unit}]")
        set_title(ax, "Gyro" if name == "gyro" else "Accelerometer")
    legend_below(figure, axes[0, 0])
    return figure


def _interval(one: Density) -> str:
    return f"{one.low:.2e} to {one.high:.2e}"
