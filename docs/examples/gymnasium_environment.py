"""The walking robot as a Gymnasium environment, for libraries of reinforcement learning.

    pip install gymnasium
    python gymnasium_environment.py

A batch runs in processes: `gymnasium.vector.AsyncVectorEnv([make(seed) for seed in range(8)])`.
"""

import gymnasium
import numpy as np

import surefoot
from surefoot.extend import Ground, Scenario, Segment, WalkingEnvironment

REACH = 0.6
"""rad, from the home pose, of a joint's target at an action of one."""


class Walking(gymnasium.Env):
    """`surefoot.sim.walking.dm_environment.WalkingEnvironment` behind Gymnasium's interface.

    Actions (12,) from -1 to 1 are targets of the joints about their home pose. Observations are the
    environment's own, but for the time, one after the other. `env.walking.log()` is the log.
    """

    metadata = {"render_modes": []}  # noqa: RUF012  as Gymnasium has it

    def __init__(self, scenario: Scenario, robot: surefoot.Robot, seed: int = 0):
        self.home, self.render_mode = robot.q_home, None
        self.walking = WalkingEnvironment(scenario, robot, seed, actions="position")
        self.names = [name for name in self.walking.observation_spec() if name != "time"]
        size = sum(self.walking.observation_spec()[name].shape[0] for name in self.names)
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float64)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (12,), np.float32)

    def reset(self, *, seed=None, options=None):
        """Another seed draws what the scenario has ranges for anew."""
        super().reset(seed=seed)
        return self._flat(self.walking.reset(seed)), {}

    def step(self, action):
        step = self.walking.step(self.home + REACH * np.asarray(action, dtype=float))
        fell = step.last() and step.discount == 0.0
        return self._flat(step), float(step.reward), fell, step.last() and not fell, {}

    def _flat(self, step) -> np.ndarray:
        return np.concatenate([step.observation[name] for name in self.names])


def make(seed: int, seconds: float = 4.0, speed: float = 0.4):
    """What makes an environment, as the vector environments of Gymnasium take it."""
    scenario = Scenario("gymnasium", (Segment(seconds, speed),), Ground(0.8))
    return lambda: Walking(scenario, surefoot.Robot.load("spot_class"), seed)


if __name__ == "__main__":
    env = make(0)()
    observation, _ = env.reset(seed=0)
    over, total = False, 0.0
    while not over:  # your policy goes here: this one stands
        observation, reward, fell, late, _ = env.step(np.zeros(12))
        over, total = fell or late, total + reward
    print(f"reward {total:.1f}; {len(env.walking.log().t)} samples in its log")
