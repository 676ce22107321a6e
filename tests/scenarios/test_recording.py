"""The recording is read back and compared with the walk it was made from."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np
import pytest
import rerun as rr
from arc_walk import DRIFT, RATE, Walk
from refusals import refused
from rerun.chunk import RrdReader

from surefoot.scenarios.estimate.error_series import ErrorSeries, error_series
from surefoot.scenarios.estimate.estimators import ESTIMATORS, shown_at_first, traits
from surefoot.scenarios.reporting.palette import estimator_color, friction_color
from surefoot.scenarios.viewer.recording import RecordedWalk, write_recording
from surefoot.scenarios.viewer.scene import write_estimates
from surefoot.scenarios.viewer.shapes import geom_shapes
from surefoot.sim.common.quaternion import matrix_from_quaternion
from surefoot.sim.ground.ground_metadata import ground_metadata
from surefoot.sim.ground.height_map import height
from surefoot.sim.ground.terrain import Ground, Strip
from surefoot.sim.log import Log


class Contents:
    """Columns of a recording by entity: moving ones and static ones apart."""

    def __init__(self, path: Path):
        self.moving: dict[str, dict[str, list]] = {}
        self.static: dict[str, dict[str, list]] = {}
        self.timelines: set[str] = set()
        for chunk in RrdReader(path).stream().to_chunks():
            self.timelines |= set(chunk.timeline_names)
            kept = self.static if chunk.is_static else self.moving
            batch = chunk.to_record_batch()
            columns = kept.setdefault(chunk.entity_path, {})
            for name in batch.schema.names:
                columns.setdefault(name, []).extend(batch[name].to_pylist())

    def time(self, entity: str) -> np.ndarray:
        return np.array([t.total_seconds() for t in self.moving[entity]["time"]])

    def values(self, entity: str, component: str = "Scalars:scalars") -> np.ndarray:
        return np.array(self.moving[entity][component])


def written(path: Path, walk: Walk) -> Contents:
    write_recording(path, RecordedWalk(*walk))
    return Contents(path)


@pytest.fixture(scope="module")
def contents(walk, tmp_path_factory) -> Contents:
    return written(tmp_path_factory.mktemp("recording") / "walk.rrd", walk)


def test_the_robot_stands_where_the_reference_says_at_50_hz(contents, walk):
    rows = np.arange(0, len(walk.log.t), 10)
    np.testing.assert_allclose(contents.time("/world/robot"), walk.log.t[rows], atol=1e-9)
    p, R = link_pose(contents, "/world/robot", len(rows))
    p_GI = p + np.einsum("nij,j->ni", R, walk.robot.p_BI)
    np.testing.assert_allclose(p_GI, walk.log.ref_p[rows], atol=1e-5)
    np.testing.assert_allclose(R @ walk.robot.R_BI, walk.log.ref_R_GI[rows], atol=1e-6)


def test_the_chain_of_links_ends_where_leg_kinematics_put_the_foot(contents, walk):
    model = walk.robot.spec().compile()
    rows = np.arange(0, len(walk.log.t), 10)
    feet_I = walk.robot.feet_I(walk.log.q[rows])
    for leg, name in enumerate(walk.robot.foot_bodies):
        body, point = model.body(name).id, np.tile(walk.robot.foot_places[leg], (len(rows), 1))
        chain = []
        while model.body(body).name != walk.robot.base_name:
            chain.insert(0, model.body(body).name)
            body = int(model.body_parentid[body])
        for depth in range(len(chain), 0, -1):
            p, R = link_pose(contents, "/world/robot/" + "/".join(chain[:depth]), len(rows))
            point = p + np.einsum("nij,nj->ni", R, point)
        foot_I = (point - walk.robot.p_BI) @ walk.robot.R_BI
        np.testing.assert_allclose(foot_I, feet_I[:, leg], atol=1e-5)


def link_pose(contents: Contents, entity: str, n: int) -> tuple[np.ndarray, np.ndarray]:
    columns = contents.moving.get(entity) or contents.static[entity]
    p = np.array(columns["Transform3D:translation"])[:, 0]
    xyzw = np.array(columns["Transform3D:quaternion"])[:, 0]
    R = matrix_from_quaternion(xyzw[:, [3, 0, 1, 2]])
    return np.broadcast_to(p, (n, 3)), np.broadcast_to(R, (n, 3, 3))


def test_velocity_bounds_lie_epsilon_about_the_observer_and_misses_are_marked(contents, walk):
    rows = walk.prediction.rows
    truth = np.einsum("nji,nj->ni", walk.log.ref_R_GI, walk.log.ref_v)[rows]
    for k, axis in enumerate("xyz"):
        observer = contents.values(f"/velocity/{axis}/observer")[:, 0]
        np.testing.assert_allclose(observer, walk.prediction.v_I[:, k])
        band = contents.values(f"/velocity/{axis}/bounds")[:, 0].reshape(-1, 2)
        for side, sign in ((0, -1), (1, 1)):
            np.testing.assert_allclose(band[:, side] - observer, sign * walk.bounds.epsilon[k])
        missed = np.abs(truth[:, k] - observer) > walk.bounds.epsilon[k]
        assert 0 < missed.sum() < len(missed)
        np.testing.assert_allclose(
            contents.time(f"/velocity/{axis}/outside"), walk.log.t[rows[missed]], atol=1e-9
        )


def test_errors_are_those_of_the_estimates(contents, walk):
    for k, axis in enumerate("xyz"):
        t = contents.time(f"/position_error/{axis}/error/leg")
        np.testing.assert_allclose(np.diff(t), 0.05, atol=1e-9)
        error = contents.values(f"/position_error/{axis}/error/leg")[:, 0]
        np.testing.assert_allclose(error, DRIFT[k] * (t - t[0]), atol=1e-9)
        right = contents.values(f"/position_error/{axis}/error/coverage")
        np.testing.assert_allclose(right, 0.0, atol=1e-9)
        bands = contents.values(f"/position_error/{axis}/3_sigma/leg").reshape(-1, 2)
        np.testing.assert_allclose(bands[:, 0], -bands[:, 1])
        assert np.all(bands[:, 1] >= 3 * 0.1)


def test_the_trail_in_pieces_is_the_path(contents):
    (path,) = contents.static["/world/estimates/leg/path"]["LineStrips3D:strips"][0]
    pieces = [
        row[0] for row in contents.moving["/world/estimates/leg/trail"]["LineStrips3D:strips"]
    ]
    joined = np.concatenate([pieces[0], *[piece[1:] for piece in pieces[1:]]])
    np.testing.assert_allclose(joined, path, atol=1e-6)


def test_contact_lanes_hold_every_change_and_slipping(contents, walk):
    contact = walk.log.contact[:, 0]
    states = [s[0] for s in contents.moving["/feet/contact/FL"]["StateChange:state"]]
    assert set(states) == {"swing", "stance", "slipping"}
    assert all(a != b for a, b in pairwise(states))
    t = contents.time("/feet/contact/FL")
    at = np.searchsorted(t, walk.log.t + 1e-9) - 1
    np.testing.assert_array_equal(np.array(states)[at] != "swing", contact)


def test_colours_are_those_of_the_palette(contents):
    color = contents.static["/position_error/x/error/leg"]["SeriesLines:colors"][0][0]
    assert f"#{color >> 8:06X}" == estimator_color("leg")
    patch = contents.static["/world/ground/friction_0.20/box"]["Boxes3D:colors"][0][0]
    assert f"#{patch >> 8:06X}" == friction_color(0.2)


def test_the_shadow_lies_on_the_ground_below_the_trunk(walk, tmp_path):
    ramp = Strip((-1.0, 2.0), (3.0, 2.0), 8.0, heights=(0.0, 0.4))
    ground = Ground(0.8, strips=(ramp,))
    meta = replace(walk.log.meta, model=ground_metadata(ground))
    contents = written(tmp_path / "ramp.rrd", walk._replace(log=replace(walk.log, meta=meta)))
    p = contents.values("/world/shadow", "Transform3D:translation")[:, 0]
    above = [z - height(ground.height_map, x, y) for x, y, z in p]
    np.testing.assert_allclose(above, 0.01, atol=1e-5)
    robot = contents.values("/world/robot", "Transform3D:translation")[:, 0]
    np.testing.assert_allclose(p[:, :2], robot[:, :2], atol=1e-5)
    assert "/world/ground/friction_0.80/box_edges" in contents.static
    (lines,) = contents.static["/world/ground/grid"]["LineStrips3D:strips"]
    x, y, z = np.concatenate(lines).T
    off = [b - height(ground.height_map, *a) for *a, b in zip(x, y, z, strict=True)]
    assert np.quantile(np.abs(np.array(off) - 0.01), 0.99) < 1e-5  # all but at the ramp's edges


def test_without_estimates_contacts_and_truth_there_is_still_a_robot(walk, tmp_path):
    kept = [c for c in walk.log.frame if not c.startswith(("contact", "slip", "mu", "ref_v"))]
    log = Log(walk.log.frame[kept], walk.log.meta)
    write_recording(tmp_path / "bare.rrd", RecordedWalk(log, walk.robot, {}))
    contents = Contents(tmp_path / "bare.rrd")
    assert {"/world/robot", "/velocity/x/truth"} <= set(contents.moving)
    assert not any(entity.startswith("/feet") for entity in contents.moving)
    (about,) = contents.static["/about"]["TextDocument:text"]
    assert "estimator" not in str(about)


def test_an_estimator_may_have_any_name_and_a_log_may_have_calendar_time(walk, tmp_path):
    offset = 1_700_000_000.0
    log = Log(walk.log.frame.assign(t=walk.log.t + offset), walk.log.meta)
    leg = walk.trajectories["leg"]
    shifted = replace(leg, t=leg.t + offset, covariance=None)
    estimates = {"my filter/v2 (new)": shifted}
    write_recording(tmp_path / "a.rrd", RecordedWalk(log, walk.robot, estimates))
    contents = Contents(tmp_path / "a.rrd")
    entity = next(e for e in contents.moving if e.startswith("/distance"))
    assert contents.moving[entity]["time"][0].year == 2023
    assert not any("3_sigma" in e for e in contents.moving)


def test_errors_are_one_clear_line(walk, tmp_path):
    (tmp_path / "there.rrd").write_bytes(b"old")
    refused(r"there\.rrd: exists already", written, tmp_path / "there.rrd", walk)
    assert (tmp_path / "there.rrd").read_bytes() == b"old"
    refused(r"a recording's name ends in \.rrd", written, tmp_path / "walk.mp4", walk)
    blind = Log(walk.log.frame.drop(columns=["ref_p_x"]), walk.log.meta)
    shown = RecordedWalk(blind, walk.robot, {})
    refused("lacks reference", write_recording, tmp_path / "b.rrd", shown)


def test_a_capsule_is_centred_where_mujoco_centres_it():
    spec = mujoco.MjSpec.from_string(
        "<mujoco><worldbody><body name='b'><geom type='capsule' size='.1' fromto='1 2 3 1 2 4'/>"
        "</body></worldbody></mujoco>"
    )
    ((name, capsule),) = geom_shapes(spec.compile(), np.array([0]))
    start = np.array(capsule.translations.as_arrow_array().to_pylist())[0]
    length = capsule.lengths.as_arrow_array().to_pylist()[0]
    x, y, z, w = capsule.quaternions.as_arrow_array().to_pylist()[0]
    end = start + length * matrix_from_quaternion(np.array([w, x, y, z]))[:, 2]
    assert name == "capsule"
    ends = sorted([start.tolist(), end.tolist()], key=lambda p: p[2])
    np.testing.assert_allclose(ends, [[1, 2, 3], [1, 2, 4]], atol=1e-6)


def test_attitude_error_is_seen_from_the_heading_of_the_robot(walk):
    """A pure roll error is about G's y axis once the robot heads along y."""
    coverage = walk.trajectories["coverage"]
    roll = np.array([[1, 0, 0], [0, np.cos(0.1), -np.sin(0.1)], [0, np.sin(0.1), np.cos(0.1)]])
    tilted = replace(coverage, R_GI=coverage.R_GI @ roll, covariance=None)
    error = error_series(replace(coverage, covariance=None), tilted)
    np.testing.assert_allclose(error.attitude, np.tile([0.1, 0, 0], (len(error.t), 1)), atol=1e-9)
    assert error.attitude_sigma is None
    assert pytest.approx(1 / np.diff(error.t).mean()) == RATE / 5


def test_a_stamp_that_rounding_puts_behind_the_last_row_is_the_last_row(walk):
    """0.352 + 116 * 0.2 is a hair more than 0.352 + 464 * 0.05."""
    t, n = 0.352 + 0.05 * np.arange(465), 465
    assert np.arange(t[0], t[-1], 0.2)[-1] > t[-1]
    eyes, none = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3))
    error = ErrorSeries(t, none, eyes, none, none, none, None, None, None, eyes)
    write_estimates(rr.RecordingStream("rounding"), {"leg": error}, walk.robot)


def test_slip_keeps_the_peak_of_every_ten_milliseconds(contents, walk):
    slip = contents.values("/feet/slip/FL")[:, 0]
    np.testing.assert_allclose(slip, walk.log.slip[:, 0].reshape(-1, 5).max(axis=1))


def test_four_are_shown_at_first_those_that_are_proposed_before_variants():
    all_of_them = [name for name in ESTIMATORS if traits(name).drawn]
    first = ("coverage", "coverage_persistent", "velocity", "leg")
    assert shown_at_first(all_of_them) == first
    assert shown_at_first(["imu", "leg"]) == ("imu", "leg")
