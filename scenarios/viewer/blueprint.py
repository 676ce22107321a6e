"""How the viewer lays a recording out: the scene on the left, one question a tab on the right."""

from collections.abc import Sequence

import rerun as rr
import rerun.blueprint as rrb

from surefoot.scenarios.viewer.scene import estimate_path
from surefoot.scenarios.viewer.series import ANGLES, AXES

_WINDOW = 3.0  # s on each side of the time cursor, about six strides
_LEGEND = rrb.PlotLegend(rrb.Corner2D.LeftTop)
_TRAIL = 10.0  # s of path behind the robot
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
    tabs: list[rrb.Vertical | rrb.View] = [
        _overview(bool(estimators), has_feet, has_slip),
        _velocity(),
    ]
    if estimators:
        tabs += [_position_error(), _attitude_error()]
    if has_feet:
        tabs.append(rrb.Vertical(*_feet(has_slip), name="Feet"))
    if has_update:
        tabs.append(_update())
    tabs.append(rrb.TextDocumentView(origin="/about", name="What is this?"))
    return rrb.Blueprint(
        rrb.Horizontal(scene, rrb.Tabs(*tabs, active_tab=0), column_shares=[1, 1]),
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
        name=f"Robot, boxes where estimators believe its trunk to be, last {_TRAIL:g} s of path",
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


def _overview(has_errors: bool, has_feet: bool, has_slip: bool) -> rrb.Vertical:
    views: list = [_velocity_view("x")]
    if has_errors:
        views.append(
            rrb.TimeSeriesView(
                origin="/distance",
                axis_x=_whole_walk(),
                plot_legend=_LEGEND,
                name="Distance between estimate and truth [m], thin: the filter's own 3σ",
            )
        )
    views += _feet(has_slip) if has_feet else []
    return rrb.Vertical(*views, name="Overview")


def _velocity() -> rrb.Vertical:
    return rrb.Vertical(*[_velocity_view(axis) for axis in AXES], name="Velocity and bounds")


def _velocity_view(axis: str) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=f"/velocity/{axis}",
        name=f"Body velocity along {axis} of the IMU ({_AXIS_WORDS[axis]}) [m/s]",
        axis_x=_around_cursor(),
        plot_legend=_LEGEND,
    )


def _position_error() -> rrb.Vertical:
    views = [
        rrb.TimeSeriesView(
            origin=f"/position_error/{axis}",
            axis_x=_whole_walk(),
            plot_legend=_LEGEND,
            name=f"Position error along {axis} of the world [m], thin: ±3σ",
        )
        for axis in AXES
    ]
    return rrb.Vertical(*views, name="Position error")


def _attitude_error() -> rrb.Vertical:
    views = [
        rrb.TimeSeriesView(
            origin=f"/attitude_error/{angle}",
            axis_x=_whole_walk(),
            plot_legend=_LEGEND,
            name=f"{angle.capitalize()} error ({_ANGLE_WORDS[angle]}) [deg], thin: ±3σ",
        )
        for angle in ANGLES
    ]
    return rrb.Vertical(*views, name="Attitude error")


def _update() -> rrb.Vertical:
    view = rrb.TimeSeriesView(
        origin="/update",
        name="Prior mass π inside the bounds: an update acts where it is below γ",
        plot_legend=_LEGEND,
        axis_x=_around_cursor(),
    )
    return rrb.Vertical(view, name="Coverage update")


def _feet(has_slip: bool) -> list:
    views: list = [
        rrb.StateTimelineView(
            origin="/feet/contact",
            name="Feet on the ground (magenta: slipping)",
            time_view=_around_cursor(),
        )
    ]
    if has_slip:
        views.append(
            rrb.TimeSeriesView(
                origin="/feet/slip",
                name="Slip speed of loaded feet over the ground [m/s]",
                axis_x=_around_cursor(),
                plot_legend=_LEGEND,
            )
        )
    return views


def _whole_walk() -> rrb.TimeAxis:
    return rrb.TimeAxis(
        view_range=rr.TimeRange(
            start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.infinite()
        )
    )


def _around_cursor() -> rrb.TimeAxis:
    return rrb.TimeAxis(
        view_range=rr.TimeRange(
            start=rrb.TimeRangeBoundary.cursor_relative(seconds=-_WINDOW),
            end=rrb.TimeRangeBoundary.cursor_relative(seconds=_WINDOW),
        )
    )
