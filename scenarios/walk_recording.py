"""A simulated walk as a recording: on the ground that its seed drew, with every filter on it."""

from collections.abc import Sequence
from pathlib import Path

from models.predict import predict
from scenarios.filters import Learnt, declared_model, run_all
from scenarios.recording import write_recording
from sim.batch import Job, known_robot
from sim.log import Log
from sim.walk import plan


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
