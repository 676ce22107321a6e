"""Layout of a recording in the viewer: the scene on the left, one topic per tab on the right.

Legends would cover the curves: plots of a whole walk leave room for theirs before its start, and
those around the cursor explain the colours in their titles.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from surefoot.scenarios.estimate.error_series import NAMED_AXES, QUANTITIES
from surefoot.scenarios.estimate.estimators import shown_at_first
from surefoot.scenarios.viewer.scene import estimate_path, trunk_size
from surefoot.scenarios.viewer.series import BANDS
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot

_Time = rrb.TimeRangeBoundary
_WINDOW = 3.0  # s on each side of the time cursor, about six strides
_LEGEND = rrb.PlotLegend(rrb.Corner2D.LeftTop)
_NO_LEGEND = rrb.PlotLegend(visible=False)
_ROOM = 0.45  # of a walk's duration, before its begin: for the legend
_TRAIL = 10.0  # s of path behind the robot
_THIN = "band: ±3σ"
_SHARES = (4, 6, 5, 4)  # heights of the overview's plots: legends need the second's
EXPLANATION = "What is this?"
"""The tab that is open initially."""


def layout(
    log: Log, robot: Robot, estimators: Sequence[str], has_update: bool, tab: str = EXPLANATION
) -> rrb.Blueprint:
    """The blueprint of one recording.

    Args:
        log: the walk.
        robot: whose size determines the camera's distance.
        estimators: their names; without any there are no error tabs.
        has_update: masses of the coverage update were written.
        tab: that is open initially.
    """
    shown = shown_at_first(estimators)
    scene = rrb.Vertical(_following(estimators, shown, robot), _map(log, estimators, shown))
    scene.row_shares = [3, 2]
    distance = ("/distance", "Distance between estimate and truth [m], thin: the filter's own 3σ")
    errors = [_whole_walk(log, shown, *distance)] if estimators else []
    tabs: dict[str, list[rrb.View]] = {
        "Overview": [_velocity(*NAMED_AXES[0]), *errors, *_feet(log)],
        "Velocity and bounds": [_velocity(*axis) for axis in NAMED_AXES],
    }
    for kind, words, axes, _ in QUANTITIES[:2] if estimators else ():
        quantity, _, unit = words.partition(" ")
        title = f"{quantity.capitalize()} error"
        tabs[title] = [
            _whole_walk(log, shown, f"/{kind}_error/{axis}", f"{title}, {axis} {unit}, {_THIN}")
            for axis in axes
        ]
    if set(shown) != set(estimators):
        tabs["All estimators"] = [
            _map(log, estimators, estimators),
            _whole_walk(log, estimators, *distance),
        ]
    if log.has("contact"):
        tabs["Feet"] = _feet(log)
    if has_update:
        name = "Prior mass π inside the bounds: an update acts where it is below γ"
        tabs["Coverage update"] = [_plot("/update", name, _LEGEND)]
    about = rrb.TextDocumentView(origin="/about", name=EXPLANATION)
    columns = {name: rrb.Vertical(*views, name=name) for name, views in tabs.items()}
    columns["Overview"].row_shares = _SHARES[: len(tabs["Overview"])] if estimators else None
    opened = [EXPLANATION, *tabs].index(tab)
    return rrb.Blueprint(
        rrb.Horizontal(
            scene, rrb.Tabs(about, *columns.values(), active_tab=opened), column_shares=[1, 1]
        ),
        rrb.TimePanel(state="collapsed", timeline="time", play_state="paused"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
    )


def _following(estimators: Sequence[str], shown: Sequence[str], robot: Robot) -> rrb.Spatial3DView:
    """View in a frame that moves with the robot without rotating, so the robot stays in view."""
    place = 4.0 * trunk_size(robot)[0] * np.array([-0.9, -1.2, 0.8])
    boxes = ", boxes: its trunk as estimated" if estimators else ""
    return rrb.Spatial3DView(
        **_scene(estimators, shown, ("path", "body/dot", "ellipsoid"), ("robot/dot", "truth/path")),
        origin="/world/follow",
        name=f"Robot{boxes}, last {_TRAIL:g} s of path; lines 1 m apart",
        eye_controls=_eye(place, (0.0, 0.0, 0.3 * place[2]), up=(0.0, 0.0, 1.0)),
        time_ranges=rrb.VisibleTimeRange(
            "time", start=_Time.cursor_relative(seconds=-_TRAIL), end=_Time.cursor_relative()
        ),
    )


def _map(log: Log, estimators: Sequence[str], shown: Sequence[str]) -> rrb.Spatial3DView:
    """View of the whole walk from above."""
    lower, upper = log.ref_p.min(axis=0), log.ref_p.max(axis=0)
    centre, span = 0.5 * (lower + upper), float((upper - lower)[:2].max()) + 1.0
    hidden = ("trail", "body/outline", "body/forward", "body/pole", "body/flag")
    found = ", estimates, dots where they are now, wire: 3σ" if estimators else ""
    return rrb.Spatial3DView(
        **_scene(estimators, shown, hidden, ("truth/trail",)),
        origin="/world",
        name=f"Whole walk from above: truth (grey){found}",
        eye_controls=_eye(centre + span * np.array([0.0, -0.02, 1.15]), centre, up=(0.0, 1.0, 0.0)),
    )


def _scene(
    estimators: Sequence[str], shown: Sequence[str], parts: Sequence[str], others: Sequence[str]
) -> dict[str, Any]:
    """Options of a view of the world without `parts` of each estimate and without `others`; the
    estimates that are not `shown` are hidden until their eye in the view's list is clicked.
    """
    hidden = [estimate_path(name) for name in estimators if name not in shown]
    estimates = [f"- /{estimate_path(name)}/{part}" for name in estimators for part in parts]
    return {
        "overrides": {path: rrb.EntityBehavior(visible=False) for path in hidden},
        "contents": ["/world/**", *(f"- /world/{other}" for other in others), *estimates],
        "line_grid": rrb.LineGrid3D(visible=False),
    }


def _eye(place: np.ndarray, target: Sequence[float], up: Sequence[float]) -> rrb.EyeControls3D:
    kind = rrb.Eye3DKind.Orbital
    return rrb.EyeControls3D(kind=kind, position=place, look_target=target, eye_up=up)


def _plot(origin: str, name: str, legend: rrb.PlotLegend) -> rrb.TimeSeriesView:
    """Series under `origin`, a few strides around the time cursor."""
    return rrb.TimeSeriesView(origin=origin, name=name, axis_x=_about_cursor(), plot_legend=legend)


def _whole_walk(log: Log, estimators: Sequence[str], origin: str, name: str) -> rrb.TimeSeriesView:
    """Series of estimators under `origin` over the whole walk, with the legend before its start."""
    start, end = float(log.t[0]), float(log.t[-1])
    times = (_Time.absolute(seconds=at) for at in (start - _ROOM * (end - start), end))
    parts = [rr.escape_entity_path_part(name) for name in estimators]
    return rrb.TimeSeriesView(
        origin=origin,
        contents=[f"{origin}/{kind}/{part}" for part in parts for kind in (BANDS, "error")],
        name=name,
        axis_x=rrb.TimeAxis(view_range=rr.TimeRange(*times)),
        plot_legend=_LEGEND,
    )


def _velocity(axis: str, word: str) -> rrb.TimeSeriesView:
    along = f"{axis} of the IMU ({word})"
    colours = "truth grey, magenta outside the bounds (band); observer orange"
    return _plot(f"/velocity/{axis}", f"Velocity along {along} [m/s]: {colours}", _NO_LEGEND)


def _feet(log: Log) -> list[rrb.View]:
    if not log.has("contact"):
        return []
    lanes = rrb.StateTimelineView(
        origin="/feet/contact",
        name="Feet on the ground (magenta: slipping)",
        time_view=_about_cursor(),
    )
    colours = "left amber and teal, right rose and violet"
    slip = _plot("/feet/slip", f"Slip speed of loaded feet [m/s]: {colours}", _NO_LEGEND)
    return [lanes, slip] if log.has("truth") else [lanes]


def _about_cursor() -> rrb.TimeAxis:
    """The times within a few strides of the time cursor."""
    start, end = (_Time.cursor_relative(seconds=at) for at in (-_WINDOW, _WINDOW))
    return rrb.TimeAxis(view_range=rr.TimeRange(start=start, end=end))
