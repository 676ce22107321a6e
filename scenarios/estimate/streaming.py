"""An estimator in a robot's own loop: samples in, states out.

`surefoot.StreamingEstimator` corresponds to `run_filter` for a log, with the same results: it
determines rate and first state from the first half second of a robot that stands, or the first
second of one in motion, then runs the filter, the observer and its decimation sample by sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np
import pandas as pd

from surefoot.estimator.core.checks import SampleError
from surefoot.estimator.core.state import NavState
from surefoot.estimator.evaluation.trajectory import Trajectory, with_mounting
from surefoot.estimator.initial import MOVING_WINDOW, STILL_WINDOW, Start, start_of
from surefoot.estimator.run import state_parts
from surefoot.scenarios.estimate.contract import (
    GROUPS_OF_FIELDS,
    IMU_SHAPES,
    LARGEST_READINGS,
    CheckedSample,
    Learnt,
    Sample,
    Stream,
    check_sample,
)
from surefoot.scenarios.estimate.estimators import estimator_named
from surefoot.scenarios.estimate.run import begin
from surefoot.scenarios.estimate.settings import FilterSettings, tuned
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.log import Log, Meta
from surefoot.sim.log.schema import group_columns
from surefoot.sim.robot.robot import Robot

_GROUPS = {"imu": ("gyro", "accel")} | {g: (field,) for g, field in GROUPS_OF_FIELDS.items()}
"""Groups of a log's columns, and the corresponding fields of a sample."""
MOST_WAITING = 50_000
"""Largest number of samples before the start: of STILL_WINDOW at 100 kHz."""


class StreamingEstimator:
    """One filter, fed sample by sample."""

    def __init__(
        self,
        filter: str,
        robot: Robot | None,
        learnt: Learnt | None = None,
        settings: FilterSettings | None = None,
    ):
        """Prepare for samples.

        Raises SurefootError for a filter that is unknown or requires whole logs.

        Args:
            filter: its name.
            robot: of the samples, with joints and contacts in the order of `robot.limbs`. None for
                a filter that needs none.
            learnt: observers and bounds.
            settings: noise, priors and start; by default those tuned for the robot.
        """
        self._estimator = estimator_named(filter)
        if hasattr(self._estimator, "prepare"):
            raise SurefootError(f"{filter} takes a whole log at once, not samples")
        self._robot, self._learnt = robot, learnt or Learnt()
        self._settings = settings or FilterSettings()
        self._mounting = tuned(robot).mounting
        shapes, needs = dict(IMU_SHAPES), self._estimator.needs
        if robot is not None:
            joints, legs = len(robot.limbs.joints), len(robot.limbs.legs)
            shapes |= dict.fromkeys(("q", "dq", "tau"), (joints,))
            shapes |= {"contact": (legs,), "force": (legs,), "foot_I": (legs, 3)}
        fields = (_GROUPS.get(group, ()) for group in ("imu", *needs.log))
        self._any = shapes, tuple(dict.fromkeys(chain.from_iterable(fields)))
        self._form = self._any  # shapes of fields, and which are needed, once there is a sample
        self._t = np.nan
        self._waiting: list[CheckedSample] = []
        self.start: Start | None = None
        """What the first state is taken from; None in the first half second."""
        self._stream: Stream | None = None

    def step(self, sample: Sample) -> NavState | None:
        """Return the state at this sample; None while the first samples are collected: those of
        STILL_WINDOW seconds or, of a robot in motion, of MOVING_WINDOW.

        The next sample starts the stream, which then processes all of them at once. At any time,
        raises SampleError for a sample that is refused; it has no effect. Raises SurefootError
        where the filter cannot start, such as on a robot that falls; samples are then collected
        anew.
        """
        if self._stream is None:
            return self._begin(sample)
        sample = check_sample(sample, self._t, *self._form)
        self._stream.step(sample)
        self._t = sample.t
        return self._stream.state

    def _begin(self, sample: Sample) -> NavState | None:
        checked = check_sample(sample, np.nan, *self._any)
        if not self._waiting:
            self.start = None
            given = {name: np.shape(value) for name, value in _fields_of(checked).items()}
            self._form = self._any[0] | given, tuple(given)
        else:
            only = len(self._waiting) == 1
            try:
                check_sample(sample, self._t, *self._form)
                if only and _fields_of(sample).keys() != set(self._form[1]):
                    raise SampleError(
                        f"the sample at {sample.t:.9g} s has other fields than the first"
                    )
            except SampleError:
                if only:  # either of the two may be wrong
                    self._waiting = []
                raise
        elapsed = checked.t - self._waiting[0].t if self._waiting else 0.0
        window = MOVING_WINDOW if self.start == "moving" else STILL_WINDOW
        if elapsed <= window and len(self._waiting) >= MOST_WAITING:
            raise SampleError(f"more than {MOST_WAITING} samples before the start")
        self._waiting.append(checked)
        self._t = checked.t
        if elapsed <= window:
            return None
        log = log_of_samples(self._waiting, self._robot)
        if self.start is None:
            self.start = self._settings.start.kind or start_of(log)
            if self.start == "moving" and elapsed <= MOVING_WINDOW:
                return None
        waiting, self._waiting = self._waiting, []
        stream = begin(self._estimator, log, self._robot, self._learnt, settings=self._settings)
        for one in waiting:
            stream.step(one)
        self._stream = stream
        return stream.state

    @property
    def state(self) -> NavState | None:
        """The last estimate; None before the first."""
        return None if self._stream is None else self._stream.state

    @property
    def unlike(self) -> float:
        """Distance of the walk so far from those that the filter's observer was trained on, 1 being
        the farthest of these; NaN where it is not known (`surefoot.models.observer.novelty`).
        """
        return getattr(self._stream, "unlike", np.nan)

    @property
    def covariance(self) -> np.ndarray | None:
        """Covariance (15, 15) of its right-invariant error, including the mounting tolerance."""
        if self._stream is None:
            return None
        parts = state_parts(self._stream.state.pack()[None])
        now = Trajectory(np.zeros(1), *parts, covariance=self._stream.covariance[None])
        found = with_mounting(now, self._mounting).covariance
        assert found is not None
        return found[0]


def log_of_samples(samples: Sequence[Sample], robot: Robot | None) -> Log:
    """Checked samples with the fields of the first as a log, with the names of the robot's joints
    and legs, or numbered ones.
    """
    t = np.array([sample.t for sample in samples])
    columns = {"t": t}
    for group, names in _GROUPS.items():
        if not set(names) <= _fields_of(samples[0]).keys():
            continue
        arrays = [np.array([getattr(one, name) for one in samples], dtype=float) for name in names]
        if group == "foot":  # columns are by axis, then by leg
            arrays = [np.swapaxes(x, 1, 2) for x in arrays]
        count = arrays[0].shape[-1]
        joints = [f"joint{k + 1}" for k in range(count)] if robot is None else robot.limbs.joints
        legs = [f"leg{k + 1}" for k in range(count)] if robot is None else robot.limbs.legs
        values = np.concatenate([x.reshape(len(t), -1) for x in arrays], axis=1)
        named = group_columns(group, tuple(joints), tuple(legs))
        columns |= dict(zip(named, values.T, strict=True))
    rate = float(f"{1.0 / np.median(np.diff(t)):.6g}")
    return Log(pd.DataFrame(columns), Meta(rate), "samples")


def _fields_of(sample: Sample) -> dict[str, np.ndarray]:
    """The readings of a sample by their field."""
    each = {name: getattr(sample, name) for name in LARGEST_READINGS}
    return {name: value for name, value in each.items() if value is not None}
