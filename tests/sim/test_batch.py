"""A batch of walks on threads: each with the bits that it has alone."""

import threading

import mujoco
import numpy as np
import pytest
from mujoco import rollout

from surefoot.sim.ground.terrain import Ground, Patch, Strip
from surefoot.sim.physics.stepper import at_time_of_rates
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Ranges, Scenario, Segment
from surefoot.sim.walk import Fallen, plan, simulate_motion, walk
from surefoot.sim.walking.batch import Job, on_threads, walk_job

FLAT = Scenario(
    "flat",
    (Segment(1.5, 0.6, turn=0.2),),
    Ground(0.8, (Patch(1.0, 0.0, 0.6, 3.0, 0.2),), 20.0),
    ranges=Ranges(mu=(0.8, 1.2), speed=(0.9, 1.1), payload=(0.0, 3.0)),
)
ROUGH = Scenario(
    "rough",
    (Segment(1.0, 0.5),),
    Ground(0.7, (), 20.0, (Strip((0.6, 0.0), (3.0, 0.0), 4.0, rough=0.03),)),
)


def test_a_batch_gives_the_bits_of_walks_alone():
    """Robots, grounds and lengths differ within the batch, and more walks than threads."""
    jobs = [
        Job(FLAT, "spot_class", 0),
        Job(ROUGH, "v60_class", 1),
        Job(FLAT, "spot_class", 2),
        Job(ROUGH, "spot_class", 1),
    ]
    logs = {}
    for log in on_threads(jobs, walk_job, threads=3):
        logs[log.meta.scenario, log.meta.robot, log.meta.seed] = log
    assert len(logs) == len(jobs)
    for job in jobs:
        alone = walk(job.scenario, Robot.load(job.robot), job.seed)
        beside = logs[job.scenario.name, job.robot, job.seed]
        assert alone.frame.equals(beside.frame)
        assert alone.meta == beside.meta


def test_progress_never_falls_and_ends_at_one():
    shares = []
    list(on_threads([Job(ROUGH, "spot_class", s) for s in (0, 1)], walk_job, 2, shares.append))
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1.0)


def test_an_error_stops_the_walks_that_are_on():
    """Nothing of the batch goes on in the background."""
    long = Scenario("long", (Segment(300.0, 0.5, turn=0.3),), Ground(0.8))
    jobs = [Job(ROUGH, "spot_class", 0), Job(long, "spot_class", 0)]

    def refuse(job, report):
        walk_job(job, report)
        raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        list(on_threads(jobs, refuse, 2))
    assert not [t for t in threading.enumerate() if t.name.startswith("walk")]


def test_the_recorded_torques_replay_to_the_same_states_in_the_bare_engine():
    """The compiled loop steps MuJoCo and nothing else: `mujoco.rollout` ends in the same bits."""
    made = plan(FLAT, Robot.load("spot_class"), 5)
    motion = simulate_motion(made.world, made.robot, made.gait, made.course)
    model, data = made.world.model, mujoco.MjData(made.world.model)
    data.qpos[:] = made.world.start
    first = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(model, data, first, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    states, _ = rollout.rollout(model, data, first[None], motion.tau[None])
    qpos, qvel = np.split(np.asarray(states)[0, :, 1 : 1 + model.nq + model.nv], [model.nq], axis=1)
    assert np.array_equal(qvel[:, :3], motion.v_GB[1:])
    qpos = at_time_of_rates(qpos, qvel)
    assert np.array_equal(qpos[:, :3], motion.p_GB[1:])
    assert np.array_equal(qpos[:, made.world.qpos_adr], motion.q[1:])


def test_a_walk_that_goes_wrong_numerically_is_a_fall(tmp_path, monkeypatch):
    """MuJoCo resets a world that explodes: that must not look like walking."""
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warnings into the folder that it runs in
    made = plan(FLAT, Robot.load("spot_class"), 0)
    made.world.start[7] = 1e11
    with pytest.raises(Fallen, match=r"fell at 0\.\d+ s"):
        simulate_motion(made.world, made.robot, made.gait, made.course)
