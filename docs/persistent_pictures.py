"""The pictures of the guide on errors that last, from the walk of `surefoot demo`.

`python docs/persistent_pictures.py out/demo` (or `make readme`, which runs the demo first). The
walks of the calibration are found in the cache, where the demo has left them.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import surefoot
from surefoot.estimator.evaluation.trajectory import reference
from surefoot.models.calibration.bias_model import BiasModel
from surefoot.models.observer.predict import prediction_errors
from surefoot.scenarios.demo import LEARNING
from surefoot.scenarios.estimate.error_series import NAMED_AXES, error_series
from surefoot.scenarios.estimate.inputs import learnt_from
from surefoot.scenarios.reporting.palette import INK, estimator_color
from surefoot.scenarios.reporting.plotting import (
    label_decades,
    legend_below,
    new_figure,
    save_figure,
    set_title,
)
from surefoot.scenarios.training.many_walks import many_walks

GUIDES = Path(__file__).resolve().parent / "guides"
RATE = 100.0
"""Rate of the observer's errors [Hz]."""
TIMES = np.geomspace(0.25, 20.0, 24)
"""Times over which errors are averaged [s]."""
FILTERS = ("coverage", "coverage_persistent")


def spread_of_means(errors: list[np.ndarray], time: float) -> np.ndarray:
    """Root mean square (3,) [m/s] of the means of errors (n, 3) over so many seconds."""
    window = round(time * RATE)
    means = [part[: len(part) // window * window].reshape(-1, window, 3).mean(1) for part in errors]
    return np.sqrt((np.concatenate(means) ** 2).mean(axis=0))


def modelled(part: BiasModel, time: float) -> tuple[np.ndarray, np.ndarray]:
    """The same by the model: of both parts together, and of the mixing part alone."""
    mixing = part.within.diagonal() / (time * RATE)
    x = time / part.time_constant
    # Variance of the mean of a first-order Gauss-Markov process over a time.
    share = 1.0 if x == 0 else 2.0 * (x - 1.0 + np.exp(-x)) / x**2
    lasting = part.course.diagonal() + share * part.covariance.diagonal()
    return np.sqrt(lasting + mixing), np.sqrt(mixing)


def means_figure(errors: list[np.ndarray], part: BiasModel) -> Figure:
    """Spread of the errors' means against the time over which they are averaged, by axis."""
    figure, axes = new_figure(1, 3, size=(9.0, 3.6))
    found = np.array([spread_of_means(errors, time) for time in TIMES])
    both, alone = (np.array(x) for x in zip(*(modelled(part, t) for t in TIMES), strict=True))
    for k, (axis, word) in enumerate(NAMED_AXES):
        ax = axes[0, k]
        ax.loglog(TIMES, 1e3 * found[:, k], "o", color=INK, markersize=3.5, label="measured")
        ax.loglog(TIMES, 1e3 * both[:, k], color=estimator_color(FILTERS[1]), label="model")
        mixing = "model without the part that lasts"
        ax.loglog(TIMES, 1e3 * alone[:, k], "--", color=estimator_color(FILTERS[0]), label=mixing)
        set_title(ax, f"{axis} ({word})")
        ax.set_xlabel("averaged over [s]")
        for one in (ax.xaxis, ax.yaxis):
            label_decades(one)
    axes[0, 0].set_ylabel("RMS of the mean [mm/s]")
    legend_below(figure, axes[0, 0])
    return figure


def errors_figure(demo: Path) -> Figure:
    """Error of the height on the demo's walk, and each filter's 3 sigma about zero."""
    log = surefoot.Log.read(demo / "logs" / "walk.parquet")
    robot = surefoot.Robot.for_log(log)
    learnt = learnt_from([demo / "observer_mse.safetensors"], [demo / "bounds_mse.json"])
    figure, axes = new_figure(size=(7.5, 3.6))
    ax = axes[0, 0]
    for name in FILTERS:
        estimate = surefoot.run_filter(name, log, robot, learnt).trajectory
        series = error_series(reference(log), estimate, 20.0)
        assert series.position_sigma is not None
        color, sigma = estimator_color(name), 3.0 * series.position_sigma[:, 2]
        ax.plot(series.t, series.position[:, 2], color=color, label=name)
        ax.plot(series.t, sigma, "--", color=color, label=f"{name}, 3σ")
        ax.plot(series.t, -sigma, "--", color=color)
    ax.set_xlabel("time [s]")
    ax.set_ylabel("height error [m]")
    legend_below(figure, ax)
    return figure


def write(demo: Path) -> None:
    """Write both pictures beside the guide."""
    observer = surefoot.Observer.load(demo / "observer_mse.safetensors")
    part = surefoot.Bounds.load(demo / "bounds_mse.json").persistent
    assert part is not None  # the demo's walks are long enough
    walks = many_walks(LEARNING, role="calibrate")
    errors = [prediction_errors(observer, log)[1] for log in walks]
    save_figure(means_figure(errors, part), GUIDES / "persistent_error_1.png", force=True)
    save_figure(errors_figure(demo), GUIDES / "persistent_error_2.png", force=True)


if __name__ == "__main__":
    write(Path(sys.argv[1]))
