"""An estimator in a robot's own loop: samples in, states out.

`surefoot.StreamingEstimator` corresponds to `run_filter` for a log, with the same results: it
determines rate, attitude and gyro bias in the first half second, in which the robot stands, then
runs the filter, the observer and its decimation sample by sample.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from surefoot.estimator.core.state import NavState
from surefoot.estimator.evaluation.mounting_tolerance import with_mounting
from surefoot.estimator.evaluation.trajectory import Trajectory
from surefoot.estimator.initial import STILL_WINDOW
from surefoot.scenarios.estimate.contract import Learnt, Sample, Stream
from surefoot.scenarios.estimate.estimators import estimator_named
from surefoot.scenarios.estimate.run import begin
from surefoot.scenarios.estimate.settings import FilterSettings
from surefoot.scenarios.estimate.tuned import tuned
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.log import Log, Meta
from surefoot.sim.log.schema import group_columns
from surefoot.sim.robot.robot import Robot

_GROUPS = {
    "imu": ("gyro", "accel"),
    "q": ("q",),
    "dq": ("dq",),
    "tau": ("tau",),
    "contact": ("contact",),
    "foot": ("foot_I",),
}
"""Groups of a log's columns, and the corresponding fields of a sample."""


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
        self._settings, self._mounting = settings, tuned(robot).mounting
        self._waiting: list[Sample] = []
        self._stream: Stream | None = None

    def step(self, sample: Sample) -> NavState | None:
        """Return the state at this sample; None while the first STILL_WINDOW seconds are collected.

        The next sample starts the stream, which then processes all of them at once. Raises
        SurefootError where the samples lack what the filter needs, or the robot was not standing.
        """
        if self._stream is not None:
            self._stream.step(sample)
            return self._stream.state
        self._waiting.append(sample)
        if sample.t <= self._waiting[0].t + STILL_WINDOW:
            return None
        log = log_of_samples(self._waiting, self._robot)
        stream = begin(self._estimator, log, self._robot, self._learnt, settings=self._settings)
        for one in self._waiting:
            stream.step(one)
        self._stream, self._waiting = stream, []
        return stream.state

    @property
    def state(self) -> NavState | None:
        """The last estimate; None before the first."""
        return None if self._stream is None else self._stream.state

    @property
    def covariance(self) -> np.ndarray | None:
        """Covariance (15, 15) of its right-invariant error, including the mounting tolerance."""
        if self._stream is None:
            return None
        state = self._stream.state
        parts = (state.R_GI, state.v_GI, state.p_GI, state.b_a, state.b_g)
        fields = (np.asarray(value)[None] for value in parts)
        now = Trajectory(np.zeros(1), *fields, covariance=self._stream.covariance[None])
        found = with_mounting(now, self._mounting).covariance
        assert found is not None
        return found[0]


def log_of_samples(samples: Sequence[Sample], robot: Robot | None) -> Log:
    """Samples as a log, with the names of the robot's joints and legs.

    Raises SurefootError where they form no log: too few, inconsistent fields, or decreasing time.
    """
    t = np.array([sample.t for sample in samples])
    if len(t) < 2 or not (np.diff(t) > 0.0).all():
        raise SurefootError("samples: their times must increase")
    joints = () if robot is None else robot.limbs.joints
    legs = () if robot is None else robot.limbs.legs
    columns = {"t": t}
    for group, names in _GROUPS.items():
        parts = [[getattr(sample, name) for sample in samples] for name in names]
        if any(value is None for part in parts for value in part):
            continue
        arrays = [np.asarray(part, dtype=float) for part in parts]
        if group == "foot":  # columns are by axis, then by leg
            arrays = [np.swapaxes(x, 1, 2) for x in arrays]
        values = np.concatenate([x.reshape(len(t), -1) for x in arrays], axis=1)
        if group in ("contact", "foot") and robot is None:
            per_leg = 1 if group == "contact" else 3
            legs = tuple(f"leg{k + 1}" for k in range(values.shape[1] // per_leg))
        own = group_columns(group, joints, legs)
        if len(own) != values.shape[1]:
            raise SurefootError(
                f"samples: {group} has {values.shape[1]} numbers, the robot {len(own)}"
            )
        columns |= dict(zip(own, values.T, strict=True))
    rate = float(f"{1.0 / np.median(np.diff(t)):.6g}")
    return Log(pd.DataFrame(columns), Meta(rate), "samples")
