"""Every estimator in a robot's loop whose sensors do what they should not.

Whatever comes, a stream takes it, or refuses it by name and is as it was. Its state stays finite
and its covariance positive definite, and good samples that follow are taken, unless it says that it
has diverged.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, rule, run_state_machine_as_test
from refusals import refused
from synthetic import synthetic_walk

from surefoot import Bounds, Learnt, Robot, Sample, StreamingEstimator
from surefoot.estimator.core.checks import DivergedError, SampleError
from surefoot.extend import SurefootError, samples
from surefoot.models.observer.observer import observer_of_torch
from surefoot.scenarios.estimate import streaming
from surefoot.scenarios.estimate.estimators import ESTIMATORS, estimator_named
from surefoot.scenarios.estimate.radar_velocity import RADAR_COLUMNS
from surefoot.scenarios.estimate.run import begin
from surefoot.sim.log import LEGS, Log

FILES = Path(__file__).resolve().parents[1] / "data" / "0.1.0"
PERIOD = 0.002
FIELDS = ("t", "gyro", "accel", "q", "dq", "tau", "contact", "extra")
NO_NUMBERS = (np.nan, np.inf, -np.inf, 1e300, -1e300, 1e30)
WRONG_STEPS = (0.0, -PERIOD, -1.0, np.nan, np.inf, 11.0, 1e9, 1e300)
"""s from one sample to the next, as late, repeated and reversed samples have."""
ODD_STEPS = (1e-12, 1e-9, 1e-5, 0.02, 0.3, 9.0)
"""s that are allowed."""
FULL_SCALE = {"gyro": 34.9, "accel": 156.9, "q": 3.1, "dq": 50.0, "tau": 200.0}
"""Where sensors saturate: 2000 deg/s, 16 g, and the joints of a large robot."""
ALLOWED = {"gyro": 200.0, "accel": 1e4, "q": 1e4, "dq": 1e3, "tau": 1e6}
ROUNDING = 1e-12
"""Of eigenvalues, in units of the covariance's own deviations."""


@cache
def loop() -> tuple[Log, Robot, Learnt, tuple[Sample, ...]]:
    """A walk with every sensor, its robot, and what was learnt for it."""
    log, robot = synthetic_walk(0, 4.0, noise=0.1, robot="spot_class"), Robot.load("spot_class")
    phase = np.sin(2 * np.pi * 2.0 * log.t)
    more = {
        f"contact_{leg}": (phase * sign > 0.0)
        for leg, sign in zip(LEGS, (1, -1, -1, 1), strict=True)
    }
    values = np.full((len(log.t), len(RADAR_COLUMNS)), np.nan)
    values[5::28] = np.r_[0.5, 0.0, 0.0, 2.5e-3 * np.eye(3).ravel()]
    more |= dict(zip(RADAR_COLUMNS, values.T, strict=True))
    log = replace(log, frame=log.frame.assign(**{n: np.float64(x) for n, x in more.items()}))
    observer = replace(observer_of_torch(FILES / "observer_q_dq_gml.pt"), robot=robot.name)
    bounds = replace(Bounds.load(FILES / "bounds.json"), observer=observer.hash)
    return log, robot, Learnt((observer,), (bounds,)), tuple(samples(log))


class InLoop(RuleBasedStateMachine):
    """A stream, the stamp of its last sample and the row of the walk that comes next."""

    name = "imu"
    steps = 0
    refused = 0
    diverged = 0

    def __init__(self):
        super().__init__()
        self.begin()

    def begin(self) -> None:
        self.stream, self.t, self.row = begin(estimator_named(self.name), *loop()[:3]), 0.0, 0
        self.take(loop()[3][0], must=True)

    def next(self, after: float = PERIOD, **changed) -> Sample:
        every = loop()[3]
        self.row = (self.row + 1) % len(every)
        return every[self.row]._replace(t=self.t + after, **changed)

    def take(self, sample: Sample, must: bool = False) -> None:
        type(self).steps += 1
        before = self.seen()
        try:
            self.stream.step(sample)
        except DivergedError:
            type(self).diverged += 1
            self.check()
            self.begin()
        except SurefootError:
            if must:
                raise
            type(self).refused += 1
            for one, other in zip(before, self.seen(), strict=True):
                np.testing.assert_array_equal(one, other)
        else:
            self.t = sample.t
        self.check()

    def seen(self) -> tuple[np.ndarray, ...]:
        state = self.stream.state
        return state.R_GI, state.v_GI, state.p_GI, state.b_a, state.b_g, self.stream.covariance

    def check(self) -> None:
        *state, P = self.seen()
        for one in (*state, P):
            assert np.isfinite(one).all()
        assert np.abs(state[0] @ state[0].T - np.eye(3)).max() < 1e-6
        scale = np.sqrt(np.diag(P))
        assert (scale > 0.0).all()
        assert np.linalg.eigvalsh(P / np.outer(scale, scale))[0] > -ROUNDING

    @rule(count=st.integers(1, 60))
    def good(self, count):
        for _ in range(count):
            self.take(self.next(), must=True)

    @rule(field=st.sampled_from(FIELDS), value=st.sampled_from(NO_NUMBERS), at=st.integers(0, 11))
    def no_number(self, field, value, at):
        refused = self.refused
        sample = self.next()
        self.take(spoilt(sample, field, value, at))
        # A radar is some filters' alone, and NaN where it saw nothing.
        assert self.refused > refused or field == "extra"
        self.take(self.next(), must=True)

    @rule(step=st.sampled_from(WRONG_STEPS))
    def at_a_wrong_time(self, step):
        refused = self.refused
        self.take(self.next(step))
        assert self.refused > refused
        self.take(self.next(), must=True)

    @rule(steps=st.lists(st.sampled_from((*ODD_STEPS, PERIOD)), min_size=1, max_size=20))
    def unevenly(self, steps):
        for step in steps:
            if self.t + step > self.t:
                self.take(self.next(step), must=True)

    @rule(names=st.sets(st.sampled_from(list(FULL_SCALE))), sign=st.sampled_from((-1.0, 1.0)),
          count=st.integers(1, 60))  # fmt: skip
    def saturated(self, names, sign, count):
        for _ in range(count):
            sample = self.next()
            full = {n: np.full_like(getattr(sample, n), sign * FULL_SCALE[n]) for n in names}
            self.take(sample._replace(**full), must=True)

    @rule(names=st.sets(st.sampled_from(list(ALLOWED))), seed=st.integers(0, 1000),
          count=st.integers(1, 20))  # fmt: skip
    def as_wild_as_is_allowed(self, names, seed, count):
        rng = np.random.default_rng(seed)
        for _ in range(count):
            sample = self.next()
            shapes = {n: np.shape(getattr(sample, n)) for n in names}
            wild = {n: rng.uniform(-1.0, 1.0, s) * ALLOWED[n] for n, s in shapes.items()}
            self.take(sample._replace(**wild))

    @rule(count=st.integers(1, 60))
    def frozen(self, count):
        sample = self.next()
        for _ in range(count):
            self.take(sample._replace(t=self.t + PERIOD), must=True)

    @rule(stands=st.tuples(*[st.booleans()] * 4), count=st.integers(1, 60))
    def contacts(self, stands, count):
        for _ in range(count):
            self.take(self.next(contact=np.array(stands)), must=True)

    @rule(v_I=st.sampled_from((0.0, 30.0, 999.0, 1e4, np.inf)),
          cov=st.sampled_from((0.0, 1e-300, 1e-12, 1.0, 1e12, 1e300, -1.0, np.nan)))  # fmt: skip
    def radar(self, v_I, cov):
        values = np.r_[v_I, 0.0, 0.0, cov * np.eye(3).ravel()]
        self.take(self.next(extra=dict(zip(RADAR_COLUMNS, values, strict=True))))


def spoilt(sample: Sample, field: str, value: float, at: int) -> Sample:
    """The sample with one number of a field replaced."""
    if field == "t":
        return sample._replace(t=value)
    if field == "extra":
        extra = dict(sample.extra or {})
        extra[RADAR_COLUMNS[at]] = value
        return sample._replace(extra=extra)
    values = np.array(getattr(sample, field), dtype=float)
    values[at % len(values)] = value
    return sample._replace(**{field: values})


QUICK = ("coverage_persistent", "leg_slip")
"""Those that each change is tested with."""


def amounts():
    for name in ESTIMATORS:
        yield pytest.param(name, 300, marks=() if name in QUICK else pytest.mark.long)
        yield pytest.param(name, 10_000, marks=pytest.mark.long)
        yield pytest.param(name, 1_000_000, marks=pytest.mark.slow)


@pytest.mark.parametrize(("name", "steps"), list(amounts()))
def test_whatever_comes(name, steps):
    """About as many steps; the same ones every time, but for a million."""
    kind = type("InLoop", (InLoop,), {"name": name})
    every = settings(
        max_examples=max(steps // 175, 2),
        stateful_step_count=20,
        derandomize=steps < 1_000_000,
        phases=[Phase.generate],
        deadline=None,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
        database=None,
    )
    run_state_machine_as_test(kind, settings=every)
    assert kind.steps >= 0.9 * steps or steps < 10_000
    assert kind.refused > 0
    print(f"{name}: {kind.steps} steps, {kind.refused} refused, {kind.diverged} times diverged")


def changed(**fields):
    return lambda sample, before: sample._replace(**fields)


BAD_SAMPLES = {
    "repeated": lambda sample, before: sample._replace(t=before.t),
    "late": lambda sample, before: sample._replace(t=before.t - 0.3),
    "a stamp of another clock": changed(t=1.7e9),
    "a stamp of digits": changed(t="0.5"),
    "a complex stamp": changed(t=1j),
    "NaN": changed(gyro=np.full(3, np.nan)),
    "nothing": changed(accel=None),
    "another shape": changed(gyro=np.zeros((3, 1))),
    "digits": changed(accel=["0", "0", "9.8"]),
    "complex": changed(accel=np.array([0, 0, 9.8 + 1j])),
    "ragged": changed(gyro=[[1], [1, 2], 3]),
    "joints missing": changed(q=None),
    "a contact of a half": changed(contact=np.full(4, 0.5)),
    "a contact too many": changed(contact=np.ones(5, bool)),
    "extra text": changed(extra={"x_a": "hot"}),
    "no sample": lambda sample, before: {"t": sample.t},
}


def packed(stream: StreamingEstimator) -> np.ndarray:
    assert stream.state is not None
    return stream.state.pack()


@pytest.mark.parametrize("at", [0, 1, 20, 60])
@pytest.mark.parametrize("what", BAD_SAMPLES)
def test_a_bad_sample_is_refused_alone(what, at):
    """Before the start, at it and after it: the others give a state as if it had not come."""
    _, robot, _, every = loop()
    good = [sample._replace(extra=None) for sample in every[:600:5]]
    online, alone = StreamingEstimator("imu", robot), StreamingEstimator("imu", robot)
    skipped = []
    for row, sample in enumerate(good):
        if row == at:
            try:
                online.step(BAD_SAMPLES[what](sample, good[max(row - 1, 0)]))
            except SampleError:
                skipped.append(row)
            continue
        try:
            online.step(sample)
        except SampleError:  # a first stamp is wrong by what follows it alone
            skipped.append(row)
        alone.step(sample)
    assert len(skipped) == (0 if at == 0 and what in ("repeated", "late") else 1)
    if at > 1:
        np.testing.assert_array_equal(packed(online), packed(alone))


def test_samples_may_share_a_buffer():
    """As a driver reuses one: what is collected before the start are copies."""
    _, robot, _, every = loop()
    buffer, online, alone = np.zeros(3), *(StreamingEstimator("imu", robot) for _ in range(2))
    for sample in every[:600:5]:
        buffer[:] = sample.gyro
        online.step(sample._replace(gyro=buffer))
        alone.step(sample)
    np.testing.assert_array_equal(online.covariance, alone.covariance)
    np.testing.assert_array_equal(packed(online), packed(alone))


def test_samples_that_never_end_half_a_second_are_bounded(monkeypatch):
    monkeypatch.setattr(streaming, "MOST_WAITING", 10)
    online, first = StreamingEstimator("imu", None), Sample(0.0, np.zeros(3), np.array([0, 0, 9.8]))
    for row in range(10):
        online.step(first._replace(t=1e-9 * row))
    refused("10 samples", online.step, first._replace(t=1e-3), error=SampleError)
    assert online.step(first._replace(t=1.0)) is not None


def test_a_filter_that_cannot_start_collects_anew():
    """A robot that falls for its first second, then stands."""
    online, states, errors = StreamingEstimator("imu", None), [], 0
    for row in range(300):
        accel = np.array([0.0, 0.0, 2.0 if row < 100 else 9.8])
        try:
            states.append(online.step(Sample(0.01 * row, np.zeros(3), accel)))
        except SurefootError:
            errors += 1
    assert errors == 2
    assert states[-1] is not None
