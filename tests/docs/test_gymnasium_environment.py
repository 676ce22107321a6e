"""The example of a Gymnasium environment, by Gymnasium's own checks."""

import sys
from pathlib import Path

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium", reason="gymnasium is not installed")
sys.path.insert(0, str(Path(__file__).parents[2] / "docs/examples"))

import gymnasium_environment as example  # noqa: E402
from gymnasium.utils.env_checker import check_env  # noqa: E402

# dm_control looks for a screen on import and warns where there is none.
pytestmark = pytest.mark.filterwarnings("ignore:.*X11.*")


def test_it_is_what_gymnasium_asks_for():
    check_env(example.make(0)(), skip_render_check=True)


def test_a_batch_is_each_by_itself_and_leaves_logs():
    batch = gymnasium.vector.SyncVectorEnv([example.make(seed, 0.5) for seed in range(2)])
    seen, _ = batch.reset(seed=[0, 1])
    alone = example.make(1, 0.5)()
    np.testing.assert_array_equal(alone.reset(seed=1)[0], seen[1])
    actions = np.random.default_rng(0).uniform(-0.1, 0.1, (20, 2, 12)).astype(np.float32)
    for both in actions:
        seen, reward, *_ = batch.step(both)
        single, single_reward, *_ = alone.step(both[1])
        np.testing.assert_array_equal(single, seen[1])
        assert single_reward == reward[1]
    assert len(alone.walking.log().t) == 2 * len(actions)
