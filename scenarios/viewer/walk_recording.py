"""A simulated walk as a recording: on the ground that its seed drew, with every filter on it."""

from collections.abc import Sequence
from pathlib import Path

from surefoot.models.observer.predict import predict
from surefoot.scenarios.estimate.registry import Learnt, declared_model, run_all
from surefoot.scenarios.viewer.recording import write_recording
from surefoot.sim.log import Log
from surefoot.sim.walk import plan
from surefoot.sim.walking.batch import Job, known_robot


def record_walk(path: Path, log: Log, job: Job, learnt: Learnt, filters: Sequence[str]) -> None:
    """Write the recording of a log, the walk of `job`.

    The IMU alone is left out: it leaves the scene within seconds.
    """
    robot = known_robot(job.robot)
    results, _ = run_all(log, robot, learnt, [name for name in filters if name != "imu"])
    prediction, bounds = None, None
    if learnt.bounds:
        observer, bounds = learnt.bounded()
        prediction = predict(observer, *declared_model(log, robot))
    write_recording(
        path,
        log,
        robot,
        {result.filter: result.trajectory for result in results},
        prediction,
        bounds,
        plan(job.scenario, robot, job.seed, job.effects, job.declared).ground,
        force=True,
    )
