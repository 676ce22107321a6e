"""The simulated radar: returns lie on the ground, Dopplers are the motion's."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from reference_columns import reference_columns
from refusals import refused
from scipy.spatial.transform import Rotation

from surefoot.sim.ground.terrain import Ground, Strip
from surefoot.sim.log import Log, Meta
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walking.radar import Radar, RadarSensor, mounting, radar, radar_over

EXACT = RadarSensor(
    range_step=0.0, doppler_step=0.0, doppler_noise=0.0, azimuth_noise=0.0, elevation_noise=0.0,
    ghosts=0.0,
)  # fmt: skip
FLAT = Ground(0.8)


@pytest.fixture(scope="module")
def log() -> Log:
    """A body that sways on a winding path half a metre above the ground; no walk is needed."""
    t = np.arange(1, 2001) / 500.0
    R = Rotation.from_euler(
        "ZYX", np.column_stack([0.4 * t, 0.1 * np.sin(9 * t), 0.1 * np.sin(7 * t)])
    ).as_matrix()
    p = np.column_stack([0.7 * t, np.sin(t), 0.5 + 0.03 * np.sin(12 * t)])
    v = np.column_stack([np.full(2000, 0.7), np.cos(t), 0.36 * np.cos(12 * t)])
    frame = pd.DataFrame({"t": t} | reference_columns(R, p, v))
    return Log(frame, Meta(rate=500.0, robot="spot_class", scenario="flat", seed=4))


def in_world(log: Log, seen: Radar) -> tuple[np.ndarray, np.ndarray]:
    """Where each return's echo came from (n, 3), and the unit directions (n, 3), in G."""
    rows = seen.rows[seen.frame]
    R = log.ref_R_GI[rows]
    u = np.einsum("nij,nj->ni", R @ seen.R_IR, seen.direction_R)
    return log.ref_p[rows] + R @ seen.p_IR + seen.range[:, None] * u, u


def test_exact_returns_lie_on_the_ground_and_close_at_the_sensors_speed(log, robot):
    seen = radar_over(log, FLAT, robot, EXACT, np.random.default_rng(0))
    points, u = in_world(log, seen)
    assert len(points) > 500
    assert_allclose(points[:, 2], 0.0, atol=1e-9)
    place = log.ref_p + log.ref_R_GI @ seen.p_IR
    v = np.gradient(place, log.t, axis=0)[seen.rows[seen.frame]]
    assert_allclose(seen.doppler, -np.sum(u * v, axis=1), atol=2e-3)
    assert seen.range.max() <= EXACT.longest
    assert seen.range.min() >= EXACT.shortest


def test_a_step_is_seen_where_it_stands(log, robot):
    """A platform of 0.3 m ahead: some returns come from its top, some from its face, none below."""
    ground = Ground(0.8, strips=(Strip((2.0, 0.0), (4.0, 0.0), 6.0, (0.3, 0.3)),))
    seen = radar_over(log, ground, robot, EXACT, np.random.default_rng(0))
    points, _ = in_world(log, seen)
    assert np.sum(np.abs(points[:, 2] - 0.3) < 1e-9) > 50
    face = (points[:, 2] > 1e-6) & (points[:, 2] < 0.3 - 1e-6)
    assert np.sum(face) > 5
    assert_allclose(points[face][np.abs(points[face, 1]) < 2.9, 0], 2.0, atol=1e-9)
    assert points[:, 2].min() > -1e-9


def test_a_real_one_errs_as_its_sheet_says(log, robot):
    sensor = RadarSensor()
    seen = radar_over(log, FLAT, robot, sensor, np.random.default_rng(0))
    exact = radar_over(log, FLAT, robot, EXACT, np.random.default_rng(0))
    assert_allclose(seen.range / sensor.range_step, np.round(seen.range / sensor.range_step))
    assert_allclose(
        seen.doppler / sensor.doppler_step, np.round(seen.doppler / sensor.doppler_step), atol=1e-9
    )
    assert np.abs(seen.doppler).max() <= sensor.doppler_range
    assert_allclose(np.linalg.norm(seen.direction_R, axis=1), 1.0)
    assert 0.5 < len(seen.frame) / len(exact.frame) < 2.0
    _, u = in_world(log, seen)
    rows = seen.rows[seen.frame]
    v = log.ref_v[rows]
    far = np.abs(seen.doppler + np.sum(u * v, axis=1)) > 0.5
    assert 0.05 < far.mean() < sensor.ghosts


def test_the_log_and_its_seed_decide(log, robot):
    flat = Scenario("flat", (Segment(4.0, 0.5),), FLAT)
    first, again = radar(log, flat, robot), radar(log, flat, robot)
    for name in ("rows", "frame", "direction_R", "range", "doppler"):
        assert_array_equal(getattr(first, name), getattr(again, name))
    other = radar(Log(log.frame, replace(log.meta, seed=5)), flat, robot)
    assert not np.array_equal(first.doppler[:20], other.doppler[:20])


def test_it_looks_forward_and_down_from_the_front_hips(robot):
    p_IR, R_IR = mounting(robot, RadarSensor())
    beam_B, place_B = robot.R_BI @ R_IR[:, 0], robot.R_BI @ p_IR + robot.p_BI
    assert_allclose(beam_B, [np.cos(np.radians(15)), 0, -np.sin(np.radians(15))], atol=1e-12)
    assert 0.2 < place_B[0] < 0.5
    assert_allclose(R_IR @ R_IR.T, np.eye(3), atol=1e-12)


def test_without_a_world_it_says_so(log, robot):
    other = Scenario("other", (Segment(1.0),), FLAT)
    refused("radar: the log is of scenario flat and seed 4", radar, log, other, robot)
    refused("radar: ghosts must lie between 0 and inf, is -0.1", RadarSensor, ghosts=-0.1)
