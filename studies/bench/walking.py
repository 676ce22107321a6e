"""Speed of simulated walking relative to the bare engine, in steps per second on the same
threads.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.rollout import Rollout

from surefoot import Robot, Scenario
from surefoot.extend import Ground, Motion, Patch, Ranges, Segment
from surefoot.sim.physics.stepper import at_rest
from surefoot.sim.walk import Plan, plan, simulate_motion
from surefoot.sim.walking.batch import Job, on_threads, walk_job

COURSE = Scenario(
    "bench",
    (Segment(4.0, 0.7), Segment(2.0, 0.4, turn=0.5), Segment(2.0, 0.6, lateral=0.1)),
    Ground(0.8, (Patch(2.0, 0.0, 1.0, 2.0, 0.2),), 20.0),
    ranges=Ranges(mu=(0.9, 1.1), payload=(1.0, 3.0)),
)


@dataclass(frozen=True)
class Replay:
    """Recorded walks of equal length, for replay of their controls in the bare engine."""

    models: list[mujoco.MjModel]
    first: np.ndarray  # (walks, nstate)
    controls: np.ndarray  # (walks, steps, 12) N m
    last: np.ndarray  # (walks, 3) m/s, velocity of the base in the end

    @classmethod
    def of(cls, walks: Sequence[tuple[Plan, Motion]]) -> "Replay":
        """Collect from walks and their plans what a replay needs."""
        models = [made.world.model for made, _ in walks]
        physics = mujoco.mjtState.mjSTATE_FULLPHYSICS
        first = np.empty((len(walks), mujoco.mj_stateSize(models[0], physics)))
        for state, (made, _) in zip(first, walks, strict=True):
            model = made.world.model
            data = at_rest(made.world, made.robot, made.gait, mujoco.MjData(model)).data
            mujoco.mj_getState(model, data, state, physics)
        motions = [motion for _, motion in walks]
        return cls(
            models,
            first,
            np.stack([m.tau for m in motions]),
            np.stack([m.v_GB[-1] for m in motions]),
        )

    def run(self, threads: int = 1) -> None:
        """Step all walks by `mujoco.rollout`.

        Raises RuntimeError if the result is not bit-identical to the walk.
        """
        datas = [mujoco.MjData(self.models[0]) for _ in range(threads)]
        with Rollout(nthread=threads if threads > 1 else 0) as pool:
            states, _ = pool.rollout(self.models, datas, self.first, self.controls)
        first = 1 + self.models[0].nq  # after time and positions
        if not np.array_equal(np.asarray(states)[:, -1, first : first + 3], self.last):
            raise RuntimeError("the replay differs from the walk: the two do not do the same work")


@dataclass(frozen=True)
class Race:
    """The same walks twice: `walk` simulates them, `replay` steps the bare engine through them."""

    jobs: tuple[Job, ...]
    threads: int
    bare: Replay

    @property
    def steps(self) -> int:
        """Number of time steps of either."""
        return self.bare.controls.shape[0] * self.bare.controls.shape[1]

    def walk(self) -> None:
        """World building, controller, engine, truth and sensors: all that `sim.walk.walk` does."""
        for _ in on_threads(self.jobs, walk_job, self.threads):
            pass

    def replay(self) -> None:
        """The bare engine's part."""
        self.bare.run(self.threads)


def race(robots: int, threads: int, robot: str = "spot_class") -> Race:
    """Simulate `robots` seeds once and keep what a replay needs, which is tried once."""
    walks = []
    for seed in range(robots):
        made = plan(COURSE, Robot.load(robot), seed)
        walks.append((made, simulate_motion(made.world, made.robot, made.gait, made.course)))
    jobs = tuple(Job(COURSE, robot, seed) for seed in range(robots))
    made = Race(jobs, threads, Replay.of(walks))
    made.replay()
    return made
