"""Distances of a walk from those that an observer was trained on."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom
from synthetic import Body, synthetic_walk

from surefoot.models.observer.novelty import (
    BLOCK,
    FEWEST_BLOCKS,
    FEWEST_WALKS,
    Novelty,
    blocks_of,
    distances,
    training_states,
)
from surefoot.models.observer.observer import Observer, ObserverError
from surefoot.models.observer.predict import ObserverStream, predict
from surefoot.models.observer.settings import TrainSettings
from surefoot.models.observer.training import train


def drawn(
    rng: np.random.Generator, walks: int, blocks: int = 8, width: int = 3
) -> list[np.ndarray]:
    """Blocks of walks, each of which has its own mean, as robots differ."""
    return list(rng.normal(size=(walks, 1, width)) + rng.normal(size=(walks, blocks, width)))


def test_a_walk_like_the_others_is_seldom_farther_than_all_of_them():
    rng, trials = np.random.default_rng(0), 600
    farther = 0
    for _ in range(trials):
        *walks, another = drawn(rng, FEWEST_WALKS + 1)
        farther += np.median(distances(training_states(walks), another)) > 1.0
    assert binom.sf(farther - 1, trials, 1 / (FEWEST_WALKS + 1)) > 1e-3
    assert farther  # or the unit were too large to tell anything


def test_distances_do_not_depend_on_the_features_units():
    rng = np.random.default_rng(1)
    walks, mixed = drawn(rng, FEWEST_WALKS), rng.normal(size=(3, 3))
    known = training_states(walks)
    other = training_states([blocks @ mixed + 5.0 for blocks in walks])
    found = distances(other, walks[0] @ mixed + 5.0)
    assert found == pytest.approx(distances(known, walks[0]), rel=0.02)  # but for the ridge


def test_a_feature_that_one_walk_alone_moves_does_not_hide_other_walks():
    """As a rectified unit may be, which is zero in all others."""
    rng = np.random.default_rng(4)
    walks = [np.hstack((one, np.zeros((len(one), 1)))) for one in drawn(rng, FEWEST_WALKS + 1)]
    walks[0][:, -1] = rng.uniform(0.0, 0.1, len(walks[0]))
    far = walks.pop() + np.array([60.0, 0.0, 0.0, 0.0])
    assert np.median(distances(training_states(walks), far)) > 1.0


def test_walks_in_which_no_feature_moves_tell_nothing():
    assert training_states([np.ones((8, 3))] * FEWEST_WALKS) == {}


def test_pieces_have_the_distances_of_the_whole():
    rng = np.random.default_rng(3)
    known = training_states(drawn(rng, FEWEST_WALKS, width=4))
    x = rng.normal(size=(8 * BLOCK, 2)).astype(np.float32)
    whole, pieces = Novelty(known, 2)(x), Novelty(known, 2)
    found = np.concatenate([pieces(part) for part in np.split(x, [1, 2, 299, 300, 1000, 1001])])
    assert found == pytest.approx(whole, nan_ok=True)
    ready = FEWEST_BLOCKS * BLOCK - 1
    assert np.isnan(whole[:ready]).all()
    assert np.isfinite(whole[ready:]).all()
    assert whole[-1] == pytest.approx(np.median(distances(known, blocks_of(x))))


def test_an_observer_of_many_walks_knows_another_pace(tmp_path):
    seconds = 0.01 * BLOCK * FEWEST_BLOCKS + 1.0
    plan = TrainSettings(inputs="q,dq", steps=60, batch=4, rate=1e-2, every=60)
    walks = [synthetic_walk(seed, seconds, noise=0.1) for seed in range(FEWEST_WALKS)]
    observer = train(walks, Body(), plan)
    observer.save(tmp_path / "observer.safetensors")
    loaded = Observer.load(tmp_path / "observer.safetensors")
    assert loaded.hash == observer.hash
    like = synthetic_walk(100, seconds, noise=0.1)
    faster = replace(
        like,
        frame=like.frame.assign(
            **{c: 3.0 * like.frame[c] for c in like.frame if c.startswith("dq_")}
        ),
    )
    assert predict(loaded, like, Body()).unlike[-1] < 1.0
    assert predict(loaded, faster, Body()).unlike[-1] > 1.0
    stream = ObserverStream(loaded, Body(), faster.rate, faster.joints)
    readings = {"q": faster.q, "dq": faster.dq, "gyro": faster.gyro}
    found = stream.advance(faster.t, readings).unlike
    assert found == pytest.approx(predict(loaded, faster, Body()).unlike, rel=1e-4, nan_ok=True)
    assert not train(walks[:-1], Body(), plan).training_states
    assert not train(walks[0], Body(), plan, start=observer).training_states
    with pytest.raises(ValueError, match="training_states"):
        replace(observer, training_states={"mean": np.zeros(2), "whitening": np.eye(2)}).running()
    wrong = replace(observer, training_states=dict(observer.training_states, more=np.zeros(2)))
    wrong.save(tmp_path / "wrong.safetensors")
    with pytest.raises(ObserverError, match="training_states: not of"):
        Observer.load(tmp_path / "wrong.safetensors")
