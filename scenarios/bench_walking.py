"""How near simulated walking comes to the bare engine: steps a second, by the same threads."""

from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.rollout import Rollout

from sim.batch import Job, walk_batch
from sim.robot import Robot
from sim.scenario import Ranges, Scenario, Segment
from sim.stride import start
from sim.terrain import Ground, Patch
from sim.walk import plan, simulate

COURSE = Scenario(
    "bench",
    (Segment(4.0, 0.7), Segment(2.0, 0.4, turn=0.5), Segment(2.0, 0.6, lateral=0.1)),
    Ground(0.8, (Patch(2.0, 0.0, 1.0, 2.0, 0.2),), 20.0),
    ranges=Ranges(mu=(0.9, 1.1), payload=(1.0, 3.0)),
)


@dataclass(frozen=True)
class Race:
    """The same walks twice: `walk` makes them, `replay` steps the bare engine through them."""

    jobs: tuple[Job, ...]
    threads: int
    models: list[mujoco.MjModel]
    first: np.ndarray  # (robots, nstate)
    controls: np.ndarray  # (robots, steps, 12) N m, recorded

    @property
    def steps(self) -> int:
        """Timesteps of either side."""
        return self.controls.shape[0] * self.controls.shape[1]

    def walk(self) -> None:
        """World building, controller, engine, truth and sensors: all that `sim.walk.walk` does."""
        for _ in walk_batch(self.jobs, lambda _: None, self.threads):
            pass

    def replay(self) -> np.ndarray:
        """Full states (robots, steps, nstate) of `mujoco.rollout` under the recorded controls."""
        datas = [mujoco.MjData(self.models[0]) for _ in range(self.threads)]
        with Rollout(nthread=self.threads if self.threads > 1 else 0) as pool:
            states, _ = pool.rollout(self.models, datas, self.first, self.controls)
        return np.asarray(states)


def race(robots: int, threads: int, robot: str = "spot_class") -> Race:
    """Walk `robots` seeds once and keep what a replay needs.

    Raises RuntimeError where the replay does not end in the very bits of the walk.
    """
    models, first, controls, last = [], [], [], []
    for seed in range(robots):
        made = plan(COURSE, Robot.load(robot), seed)
        motion = simulate(made.world, made.robot, made.gait, made.course)
        model, data = made.world.model, start(made.world)
        state = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
        mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        models.append(model)
        first.append(state)
        controls.append(motion.tau)
        last.append(motion.p_GB[-1])
    jobs = tuple(Job(COURSE, robot, seed) for seed in range(robots))
    made = Race(jobs, threads, models, np.stack(first), np.stack(controls))
    if not np.array_equal(made.replay()[:, -1, 1:4], np.stack(last)):
        raise RuntimeError("the replay differs from the walk: the two do not do the same work")
    return made
