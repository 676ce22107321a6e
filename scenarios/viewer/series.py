"""The time-series part of a recording: velocity and its bounds, errors with 3 sigma, feet."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

from surefoot.estimator.evaluation.trajectory import UpdateRecord
from surefoot.models.observer.samples import body_velocity
from surefoot.scenarios.estimate.error_series import QUANTITIES, ErrorSeries
from surefoot.scenarios.reporting.palette import (
    BOUNDS,
    OBSERVER,
    OUTSIDE,
    STANDING_FOOT,
    TRUTH,
    estimator_color,
    leg_color,
    rgba,
)
from surefoot.scenarios.viewer.scene import rows_at, send_columns
from surefoot.sim.effects.base import AXES
from surefoot.sim.log import Log
from surefoot.sim.physics.foot_truth import SLIPPING

if TYPE_CHECKING:
    from surefoot.models.observer.predict import Prediction

SERIES_RATE = 100.0  # Hz
BANDS = "3_sigma"
"""Path of the estimators' bands: series are drawn in the order of their names, "error" after it."""
_BAND, _FAINT = 0.25, 0.06
"""Opacity of the strokes of a single band, and of one of several overlapping ones."""


def write_velocity(
    stream: rr.RecordingStream, log: Log, prediction: Prediction | None, epsilon: np.ndarray | None
) -> None:
    """Write the body velocity v_I by axis: truth, observer, observer +- epsilon, and truth outside
    that.

    Args:
        stream: the recording.
        log: the walk, with a reference.
        prediction: an observer's rows (M,) and v_I (M, 3), or None.
        epsilon: (3,) or (M, 3) m/s, or None.
    """
    rows = np.asarray(prediction.rows) if prediction else rows_at(log, SERIES_RATE)
    crosses = rr.SeriesPoints(
        colors=[rgba(OUTSIDE)], markers=["cross"], names=["Truth outside"], marker_sizes=[4.0]
    )
    t, (truth, ok) = log.t[rows], body_velocity(log, rows)
    for k, axis in enumerate(AXES):
        root = f"velocity/{axis}"
        _send(stream, f"{root}/truth", t[ok], truth[ok, k], _lines("Truth", TRUTH, 3.0))
        if prediction is None:
            continue
        v = np.asarray(prediction.v_I)[:, k]
        if epsilon is not None:
            half = np.broadcast_to(epsilon, prediction.v_I.shape)[:, k]
            strokes = ("Bounds", BOUNDS, _BAND)
            _send_band(stream, f"{root}/bounds", t, (v - half, v + half), strokes)
            outside = ok & (np.abs(truth[:, k] - v) > half)
            _send(stream, f"{root}/outside", t[outside], truth[outside, k], crosses)
        _send(stream, f"{root}/observer", t, v, _lines("Observer", OBSERVER, 1.5))


def write_errors(stream: rr.RecordingStream, errors: Mapping[str, ErrorSeries]) -> None:
    """Write each estimator's position error [m] and attitude error [deg] by axis, with 3 sigma."""
    for name, error in errors.items():
        part = rr.escape_entity_path_part(name)
        color = estimator_color(name)
        far = f"{name}: {error.distance[-1]:.2f} m at the end"
        line = _lines(far, color, 2.0)
        _send(stream, f"distance/error/{part}", error.t, error.distance, line)
        if error.distance_sigma is not None:
            root, sigma = f"distance/{BANDS}/{part}", error.distance_sigma
            _send(stream, root, error.t, 3.0 * sigma, _lines(f"{name} 3σ", color, 1.0, 0.5))
        for kind, _, names, scale in QUANTITIES[:2]:  # velocities have plots of their own
            values, sigma = getattr(error, kind), getattr(error, f"{kind}_sigma")
            for k, axis in enumerate(names):
                root, off = f"{kind}_error/{axis}", scale * values[:, k]
                _send(stream, f"{root}/error/{part}", error.t, off, _lines(name, color, 2.0))
                if sigma is not None:
                    half, path = 3.0 * scale * sigma[:, k], f"{root}/{BANDS}/{part}"
                    strokes = (f"{name} ±3σ", color, _FAINT)
                    _send_band(stream, path, error.t, (-half, half), strokes)


def write_update(
    stream: rr.RecordingStream, name: str, record: UpdateRecord, gamma: float | None
) -> None:
    """Write the prior mass inside the bounds at each coverage update, which is active below
    gamma.
    """
    assert record.pi is not None  # Gaussian updates have none
    color = estimator_color(name)
    root = f"update/{rr.escape_entity_path_part(name)}"
    line = _lines(f"{name}: mass π", color, 1.5)
    _send(stream, f"{root}/mass", record.t, record.pi, line)
    if gamma is not None:
        level, line = np.full(2, gamma), _lines(f"{name}: γ = {gamma:g}", TRUTH, 1.5)
        _send(stream, f"{root}/gamma", record.t[[0, -1]], level, line)


def write_feet(stream: rr.RecordingStream, log: Log) -> None:
    """Write contacts by foot and, if the log has the truth, slip speed by foot."""
    t, contact = log.t, log.contact
    slip = log.slip if log.has("truth") else None
    words = np.array(["swing", "stance", "slipping"])
    style = rr.StateConfiguration(
        values=words.tolist(),
        colors=[rgba(TRUTH), rgba(STANDING_FOOT), rgba(OUTSIDE)],
        visible=[False, True, True],
    )
    for k, leg in enumerate(log.legs):
        state = contact[:, k].astype(int)
        if slip is not None:
            state = np.where(contact[:, k] & (slip[:, k] > SLIPPING), 2, state)
        changes = np.flatnonzero(np.diff(state, prepend=-1))
        path = f"feet/contact/{leg}"
        stream.log(path, style, static=True)
        columns = rr.StateChange.columns(state=words[state[changes]].tolist())
        send_columns(stream, path, t[changes], columns)
        if slip is not None:
            starts = rows_at(log, SERIES_RATE)
            peak = np.maximum.reduceat(slip[:, k], starts)
            line = _lines(leg, leg_color(leg), 1.5)
            _send(stream, f"feet/slip/{leg}", t[starts], peak, line)


def _lines(name: str, color: str, width: float, alpha: float = 1.0) -> rr.SeriesLines:
    """Style of a line [points] of this name in the legend."""
    return rr.SeriesLines(colors=[rgba(color, alpha)], widths=[width], names=[name])


def _send(stream, path: str, t: np.ndarray, values: np.ndarray, style: rr.AsComponents) -> None:
    """Draw values (N,), in the unit of the plot, over times t (N,) [s] at a path of the stream, in
    a style.
    """
    stream.log(path, style, static=True)
    send_columns(stream, path, t, rr.Scalars.columns(scalars=values))


def _send_band(
    stream,
    path: str,
    t: np.ndarray,
    sides: tuple[np.ndarray, np.ndarray],
    strokes: tuple[str, str, float],
) -> None:
    """Draw the band between two curves by strokes from side to side, dense enough to fill it.

    The viewer cannot fill areas between series.

    Args:
        stream: rerun's recording.
        path: of the entity.
        t: (N,) [s].
        sides: lower and upper (N,), in the unit of the plot.
        strokes: name in the legend, color, and opacity of a stroke, 0 to 1.
    """
    name, color, alpha = strokes
    between = np.append(0.5 * (t[1:] + t[:-1]), t[-1:] + 1e-9)
    times = np.stack([t, between], axis=1).ravel()
    style = rr.SeriesLines(
        colors=[rgba(color, alpha)], widths=[2.0], names=[name], aggregation_policy="MinMax"
    )
    _send(stream, path, times, np.stack(sides, axis=1).ravel(), style)
