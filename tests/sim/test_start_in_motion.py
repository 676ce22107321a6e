"""A log that starts in motion is said to, by `info` and `import`, and by `estimate` without a
reference: filters then start at rest."""

import numpy as np
import pytest
from synthetic import without

from surefoot.scenarios.cli.main import main
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.importing.start import start_line
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk

ROBOTS = ("spot_class", "v60_class")


@pytest.fixture(scope="module", params=ROBOTS)
def walked(request) -> tuple[Log, Robot]:
    """Two seconds of walking after one of standing."""
    robot = Robot.load(request.param)
    course = Scenario("start", (Segment(2.0, 0.6, 0.0, 0.0),), Ground(0.8))
    return walk(course, robot, 0), robot


CUTS = {
    "as recorded": ("x_",),
    "without a reference": ("ref_",),
    "without contacts": ("ref_", "contact_"),
    "without logged rates": ("ref_", "dq_"),
}


@pytest.mark.parametrize("cut", CUTS)
def test_only_logs_that_start_in_motion_are_said_to(walked, cut):
    log, robot = walked
    log = without(log, *CUTS[cut])
    for start in (0.0, 0.3, 0.6):  # it stands for one second
        rest = log.rows(log.t >= start)
        for rows in (slice(None), slice(0, 3), slice(0, None, 25)):
            assert start_line(rest.rows(rows), robot) == ""
    for start in (1.6, 1.77, 2.03, 2.31):
        moving = log.rows(log.t >= start)
        for some in (moving, moving.rows(slice(0, 3)), moving.rows(slice(0, None, 5))):
            assert start_line(some, robot).startswith("start: the robot moves already")
        said = start_line(moving, robot)
        if cut == "without contacts":
            assert "legs" not in said
            assert "start.velocity=1" in said
            continue
        shown = "reference" if cut == "as recorded" else "standing legs"
        speed = float(said.partition(f"{shown} ")[2].split()[0])
        truth = walked[0].ref_v[walked[0].t >= start][:50].mean(axis=0)
        assert speed == pytest.approx(np.linalg.norm(truth), abs=0.05)


def test_logs_without_an_imu_start_no_filter_and_those_of_an_imu_alone_are_judged_by_it(walked):
    log, robot = walked
    moving = log.rows(log.t >= 1.6)
    assert start_line(without(moving, "gyro_", "accel_"), robot) == ""
    alone = without(moving, "ref_", "q_", "dq_", "contact_")
    assert start_line(alone.with_columns({"gyro_z": np.full(len(alone.t), 0.02)})) in (
        "",
        start_line(alone),
    )
    turning = alone.with_columns({"gyro_z": np.full(len(alone.t), 0.5)})
    assert "gyro 0.5" in start_line(turning)


def test_info_and_estimate_say_it_once_where_it_matters(walked, tmp_path, capsys):
    log, _ = walked
    moving, path = log.rows((log.t >= 1.6) & (log.t < 2.4)), tmp_path / "moving.parquet"
    moving.write(path)
    main(["info", str(path)])
    assert capsys.readouterr().out.count("start: ") == 1
    main(["estimate", str(path), "--filter", "leg"])
    assert "start: " not in capsys.readouterr().err, "it starts at the reference's velocity"
    without(moving, "ref_").write(path, force=True)
    for options, said in (
        ([], 1), (["--set", "start.velocity=0.7"], 0), (["--set", "state.v_GI=[0.6,0,0]"], 0)
    ):  # fmt: skip
        main(["estimate", str(path), "--filter", "leg", *options])
        assert capsys.readouterr().err.count("note: moving: start: ") == said
