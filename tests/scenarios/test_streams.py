"""Every estimator gives the same numbers a sample at a time, in pieces, and over a whole log."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused
from synthetic import without

from surefoot import Learnt, Log, Scenario, StreamingEstimator, walk
from surefoot.estimator.core.checks import SampleError
from surefoot.estimator.run import every_row
from surefoot.extend import (
    Ground,
    Needs,
    Segment,
    Trajectory,
    check_sample,
    samples,
    with_velocities,
)
from surefoot.scenarios.estimate import file
from surefoot.scenarios.estimate import radar_velocity as radar
from surefoot.scenarios.estimate.estimators import ESTIMATORS, estimator_named
from surefoot.scenarios.estimate.run import (
    begin,
    estimated_in_chunks,
    joined_trajectory,
    run_filter,
    stepped,
)
from surefoot.scenarios.settings import EstimateSettings

ARRAYS = ("t", "R_GI", "v_GI", "p_GI", "b_a", "b_g", "covariance")
CUTS = (0, 1, 700, 701, 1333, 4000)
ROUNDING = 2e-4
"""Of float32: an observer's network predicts a log as one batch, or step by step."""


@pytest.fixture(scope="module")
def log(walks) -> Log:
    """A walk with the columns of a radar."""
    one = walks[1].rows(slice(0, 4500))
    rng, rows = np.random.default_rng(0), np.arange(5, len(one.t), 28)
    values = np.full((len(one.t), len(radar.RADAR_COLUMNS)), np.nan)
    v_I = np.einsum("nji,nj->ni", one.ref_R_GI[rows], one.ref_v[rows])
    cov = np.tile(2.5e-3 * np.eye(3), (len(rows), 1, 1)).reshape(-1, 9)
    values[rows] = np.concatenate([v_I + 0.05 * rng.normal(size=v_I.shape), cov], axis=1)
    frame = one.frame.assign(**dict(zip(radar.RADAR_COLUMNS, values.T, strict=True)))
    return replace(one, frame=frame)


def pieces(log: Log) -> list[Log]:
    ends = [*(cut for cut in CUTS[1:] if cut < len(log.t)), len(log.t)]
    return [log.rows(slice(a, b)) for a, b in zip((0, *ends), ends, strict=False)]


def assert_same(a: Trajectory, b: Trajectory, tolerance: float):
    """Equal to the bit where the tolerance is zero, else relative to the largest of each array."""
    assert (a.updates is None) == (b.updates is None)
    pairs = [(getattr(a, name), getattr(b, name)) for name in ARRAYS]
    if a.updates is not None and b.updates is not None:
        for name in ("t", "v_I", "epsilon", "pi", "active"):
            pairs.append((getattr(a.updates, name), getattr(b.updates, name)))
    for one, other in pairs:
        if one is None or other is None or tolerance == 0.0:
            assert_array_equal(one, other)
        elif one.dtype == bool:
            assert np.mean(one != other) < 0.01
        else:
            assert_allclose(one, other, rtol=0.0, atol=tolerance * np.abs(one).max())


@pytest.mark.parametrize("name", list(ESTIMATORS))
def test_step_by_step_and_in_pieces_it_is_the_same(name, log, robot, learnt):
    rows = every_row(log.t)
    one_by_one = stepped(begin(estimator_named(name), log, robot, learnt), log, rows)
    in_pieces = joined_trajectory(estimated_raw(name, log, robot, learnt))
    whole = begin(estimator_named(name), log, robot, learnt)
    at_once = whole.run(log, rows) if hasattr(whole, "run") else one_by_one
    if name in ("leg", "leg_slip", "radar_leg", "imu"):
        assert_same(one_by_one, at_once, 0.0)
        assert_same(in_pieces, at_once, 0.0)
    else:
        assert_same(one_by_one, in_pieces, 1e-12)
        assert_same(in_pieces, at_once, ROUNDING)


def estimated_raw(name, log, robot, learnt):
    """The pieces of one stream; the mounting's tolerance left out."""
    stream, seen = begin(estimator_named(name), log, robot, learnt), 0
    stride = int(every_row(log.t)[1])
    for part in pieces(log):
        rows = np.arange(-seen % stride, len(part.t), stride)
        yield stream.run(part, rows, True)
        seen += len(part.t)


def test_an_estimator_that_needs_rates_says_what_derives_them(log, robot):
    bare, needs = without(log, "dq_"), Needs(log=("imu", "q", "dq"))
    refused("the log lacks dq .*with_velocities", needs.check, bare, robot)
    needs.check(with_velocities(bare, causal=True), robot)


def test_joint_rates_that_are_missing_are_the_same_in_pieces(log, robot):
    bare, leg = without(log, "dq_"), estimator_named("leg")
    rows = every_row(log.t)
    whole = begin(leg, bare, robot, Learnt()).run(bare, rows)
    assert_same(joined_trajectory(estimated_raw("leg", bare, robot, Learnt())), whole, 0.0)
    assert_same(stepped(begin(leg, bare, robot, Learnt()), bare, rows), whole, 0.0)


def test_a_simulated_radar_takes_the_whole_log(walks, robot, monkeypatch):
    one = estimator_named("radar_leg")
    found = np.zeros(1, int), np.zeros((1, 3)), np.eye(3)[None]
    monkeypatch.setattr(radar, "radar_velocity", lambda log, robot: found)
    chunks = estimated_in_chunks(one, pieces(walks[1])[1:], robot, Learnt())
    refused("a whole log at once", list, chunks)


def test_the_file_of_a_long_log_is_that_of_the_whole(walks, tmp_path, monkeypatch):
    """That its pieces take the memory of one is measured by test_hours."""
    walks[1].write(tmp_path / "walk.parquet")
    monkeypatch.setattr(file, "LOG_PIECE", 4.0)
    found = []
    for name, shortest in (("pieces", 0.0), ("whole", np.inf)):
        monkeypatch.setattr(file, "LONG", shortest)
        out = tmp_path / f"{name}.parquet"
        file.estimate_file(EstimateSettings(tmp_path / "walk.parquet", "leg", out))
        found.append((Trajectory.read(out), out.with_suffix(".tum").read_text()))
    (pieces, lines), (whole, whole_lines) = found
    assert_same(pieces, whole, 0.0)
    assert lines == whole_lines


def test_the_relative_errors_of_a_long_log_are_of_all_estimates(tmp_path, monkeypatch, robot):
    """However few are judged otherwise; only segments that end in another piece are left out."""
    path = tmp_path / "walk.parquet"
    walk(Scenario("long", (Segment(30.0, 0.5),), Ground(0.8)), robot, 0).write(path)
    whole, *_ = file.estimate_file(EstimateSettings(path, "leg"))
    monkeypatch.setattr(file, "LONG", 0.0)
    monkeypatch.setattr(file, "LOG_PIECE", 20.0)
    monkeypatch.setattr(file, "JUDGED", 100)
    pieces, *_ = file.estimate_file(EstimateSettings(path, "leg"))
    assert whole is not None
    assert pieces is not None
    assert pieces.samples <= 102 < 0.8 * whole.segments < pieces.segments < whole.segments
    for name in ("rpe_trans", "rpe_rot"):
        assert getattr(pieces, name) == pytest.approx(getattr(whole, name), rel=0.1)


def test_a_sample_without_what_legs_need_is_one_line(log, robot):
    stream = begin(estimator_named("leg"), log, robot, Learnt())
    sample = next(samples(log))
    np.testing.assert_array_equal(sample.force, log.force[0])  # as contacts, of the legs in order
    sample = sample._replace(contact=None)
    refused(r"^the sample at \S+ s lacks contact$", stream.step, sample)


@pytest.mark.parametrize("name", [n for n in ESTIMATORS if n != "radar_leg"])
def test_samples_alone_give_the_numbers_of_a_log_without_reference(name, walks, learnt, robot):
    """It finds its rate and its start in its first samples, as `run_filter` does in a log's."""
    log = without(walks[1].rows(slice(0, 2000)), "ref_")
    whole = run_filter(name, log, robot, learnt).trajectory
    wanted, online = set(whole.t.tolist()), StreamingEstimator(name, robot, learnt)
    found = {}
    for sample in samples(log):
        state = online.step(sample)
        if state is not None and sample.t in wanted:
            found[sample.t] = (state, online.covariance)
    rows = [k for k, t in enumerate(whole.t) if t in found]
    states, covariances = zip(*(found[t] for t in whole.t[rows]), strict=True)
    assert whole.t[rows[0]] < 0.52
    assert rows[-1] == len(whole.t) - 1
    for field in ("R_GI", "v_GI", "p_GI", "b_a", "b_g"):
        mine = [getattr(state, field) for state in states]
        assert_allclose(mine, getattr(whole, field)[rows], rtol=0.0, atol=ROUNDING)
    assert whole.covariance is not None
    assert_allclose(covariances, whole.covariance[rows], rtol=1e-3, atol=1e-9)


def test_the_distance_from_the_training_is_the_same(walks, learnt, robot):
    """On the robot, in pieces, and of a whole log, which says that it is not to be trusted."""
    (observer,) = (one for one in learnt.observers if one.loss == "gml")
    size = 2 * observer.width
    states = {"mean": np.zeros(size), "whitening": np.eye(size)}
    far = Learnt((replace(observer, training_states=states),))
    log = walks[1]
    found = run_filter("velocity", log, robot, far)
    assert found.trajectory.unlike is not None
    last = found.trajectory.unlike[-1]
    assert last > 1.0
    assert "unlike those that its observer was trained on" in found.health.sentence("velocity")
    (*_, piece) = estimated_in_chunks(estimator_named("velocity"), pieces(log), robot, far)
    assert piece.unlike is not None
    assert piece.unlike[-1] == pytest.approx(last, rel=1e-4)
    online = StreamingEstimator("velocity", robot, far)
    for sample in samples(log):
        online.step(sample)
    assert online.unlike == pytest.approx(last, rel=1e-4)
    assert np.isnan(StreamingEstimator("leg", robot).unlike)


def test_readings_are_checked_once_and_stamps_each_time(log):
    first, second = islice(samples(log), 2)
    checked = check_sample(second, first.t)
    assert check_sample(checked, first.t) is checked
    refused("does not follow", check_sample, checked, second.t, error=SampleError)
    refused("lacks foot_I", check_sample, checked, first.t, needed=("foot_I",), error=SampleError)


def test_what_samples_lack_is_one_line(walks, robot):
    first = list(samples(walks[1].rows(slice(0, 260))))

    def fed(name: str, altered: list) -> None:
        online = StreamingEstimator(name, robot)
        for sample in altered:
            online.step(sample)

    refused("lacks", fed, "leg", [sample._replace(q=None) for sample in first])
    refused("whole log", StreamingEstimator, "radar_leg", robot)
