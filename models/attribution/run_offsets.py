"""Effects whose size differs between runs of one machine.

Encoder zeros, IMU biases and the offset of the reference's clock change with every start, while
lengths, masses and friction belong to the machine. Over several logs, such a candidate is fitted
with a size for each.
"""

from surefoot.sim.effects import Effect

PER_RUN_EFFECTS = frozenset(
    {"encoder_offset", "torque_bias", "gyro_bias", "accel_bias", "reference_delay", "clock_scale"}
)
"""Effects whose size differs between runs."""


SAMPLING_LAGS = frozenset({"rate_delay", "torque_delay"})
"""Lags between readings of one row."""
WITHIN_ROW = 0.55
"""Share of a row up to which such a lag is one of sampling: the nearest row is half a row away, and
the lag is measured to a few percent.
"""


def is_sampling_lag(one: Effect, rate: float) -> bool:
    """Whether an effect is a lag between readings that a log at this rate [Hz] gives the same row.

    A log does not say when within a row each reading was taken. A simulator that steps rates before
    angles (semi-implicit Euler) has rates half a step before them.
    """
    return one.name in SAMPLING_LAGS and abs(one.value) * rate <= WITHIN_ROW
