"""How the viewer lays a recording out: the scene on the left, one question a tab on the right."""

from collections.abc import Sequence

import rerun as rr
import rerun.blueprint as rrb

from surefoot.scenarios.viewer.scene import estimate_path
from surefoot.scenarios.viewer.series import ANGLES
from surefoot.sim.effects.base import AXES

_WINDOW = 3.0  # s on each side of the time cursor, about six strides
_LEGEND = rrb.PlotLegend(rrb.Corner2D.LeftTop)
_TRAIL = 10.0  # s of path behind the robot
_THIN = "thin: ±3σ"
_AXIS_WORDS = {"x": "forward", "y": "left", "z": "up"}
_ANGLE_WORDS = {"roll": "about forward", "pitch": "about left", "yaw": "about up"}


def layout(
    estimators: Sequence[str],
    eye: tuple[float, float, float],
    centre: tuple[float, float, float],
    span: float,
    has_feet: bool,
    has_slip: bool,
    has_update: bool,
) -> rrb.Blueprint:
    """The blueprint of one recording.

    Args:
        estimators: their names; without any there are no error tabs.
        eye: (3,) m, where the following camera stands, seen from the robot's place on the ground.
        centre: (3,) m, middle of the walk.
        span: m, its longer side on the ground.
        has_feet: contacts were written.
        has_slip: slip speeds were written.
        has_update: masses of the coverage update were written.
    """
    scene = rrb.Vertical(_following(estimators, eye), _map(estimators, centre, span))
    scene.row_shares = [3, 2]
    feet = _feet(has_slip) if has_feet else []
    distance = "Distance between estimate and truth [m], thin: the filter's own 3σ"
    errors = [_plot("/distance", distance, whole_walk=True)] if estimators else []
    tabs: dict[str, list[rrb.View]] = {
        "Overview": [_velocity("x"), *errors, *feet],
        "Velocity and bounds": [_velocity(axis) for axis in AXES],
    }
    if estimators:
        tabs["Position error"] = [
            _plot(
                f"/position_error/{axis}",
                f"Position error along {axis} of the world [m], {_THIN}",
                whole_walk=True,
            )
            for axis in AXES
        ]
        tabs["Attitude error"] = [
            _plot(
                f"/attitude_error/{angle}",
                f"{angle.capitalize()} error ({_ANGLE_WORDS[angle]}) [deg], {_THIN}",
                whole_walk=True,
            )
            for angle in ANGLES
        ]
    if has_feet:
        tabs["Feet"] = feet
    if has_update:
        name = "Prior mass π inside the bounds: an update acts where it is below γ"
        tabs["Coverage update"] = [_plot("/update", name)]
    about = rrb.TextDocumentView(origin="/about", name="What is this?")
    columns = [rrb.Vertical(*views, name=name) for name, views in tabs.items()]
    return rrb.Blueprint(
        rrb.Horizontal(scene, rrb.Tabs(*columns, about, active_tab=0), column_shares=[1, 1]),
        rrb.TimePanel(state="collapsed", timeline="time", play_state="paused"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
    )


def _following(estimators: Sequence[str], eye) -> rrb.Spatial3DView:
    """Seen from a frame that moves with the robot without turning, so the robot stays in view."""
    estimates = [
        f"- /{estimate_path(n)}/{part}"
        for n in estimators
        for part in ("path", "body/dot", "ellipsoid")
    ]
    return rrb.Spatial3DView(
        origin="/world/follow",
        contents=["/world/**", "- /world/robot/dot", "- /world/truth/path", *estimates],
        name=f"Robot, boxes: its trunk as estimated, last {_TRAIL:g} s of path",
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital,
            position=eye,
            look_target=(0.0, 0.0, 0.3 * eye[2]),
            eye_up=(0.0, 0.0, 1.0),
        ),
        line_grid=rrb.LineGrid3D(visible=False),
        time_ranges=rrb.VisibleTimeRange(
            "time",
            start=rrb.TimeRangeBoundary.cursor_relative(seconds=-_TRAIL),
            end=rrb.TimeRangeBoundary.cursor_relative(),
        ),
    )


def _map(estimators: Sequence[str], centre, span: float) -> rrb.Spatial3DView:
    hidden = ("trail", "body/outline", "body/forward", "body/pole", "body/flag")
    estimates = [f"- /{estimate_path(n)}/{part}" for n in estimators for part in hidden]
    return rrb.Spatial3DView(
        origin="/world",
        contents=["/world/**", "- /world/truth/trail", *estimates],
        name="Whole walk from above: truth (grey), estimates, dots where they are now, wire: 3σ",
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital,
            position=(centre[0], centre[1] - 0.02 * span, centre[2] + 1.15 * span),
            look_target=centre,
            eye_up=(0.0, 1.0, 0.0),
        ),
        line_grid=rrb.LineGrid3D(visible=False),
    )


def _plot(origin: str, name: str, whole_walk: bool = False) -> rrb.TimeSeriesView:
    """Series under `origin`, over the whole walk or a few strides about the time cursor."""
    axis = _axis(None if whole_walk else _WINDOW)
    return rrb.TimeSeriesView(origin=origin, name=name, axis_x=axis, plot_legend=_LEGEND)


def _velocity(axis: str) -> rrb.TimeSeriesView:
    name = f"Body velocity along {axis} of the IMU ({_AXIS_WORDS[axis]}) [m/s]"
    return _plot(f"/velocity/{axis}", name)


def _feet(has_slip: bool) -> list[rrb.View]:
    lanes = rrb.StateTimelineView(
        origin="/feet/contact",
        name="Feet on the ground (magenta: slipping)",
        time_view=_axis(_WINDOW),
    )
    slip = _plot("/feet/slip", "Slip speed of loaded feet over the ground [m/s]")
    return [lanes, slip] if has_slip else [lanes]


def _axis(around: float | None) -> rrb.TimeAxis:
    """All times, or those within `around` seconds of the time cursor."""
    boundary = rrb.TimeRangeBoundary
    if around is None:
        start, end = boundary.infinite(), boundary.infinite()
    else:
        start = boundary.cursor_relative(seconds=-around)
        end = boundary.cursor_relative(seconds=around)
    return rrb.TimeAxis(view_range=rr.TimeRange(start=start, end=end))
