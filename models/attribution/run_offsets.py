"""What each run of a machine has for itself: zeros of its sensors, and its reference's clock.

Encoders are homed, an IMU's biases drawn and a reference's clock started anew with every run, while
lengths, masses and frictions are the machine's. Of several logs such a candidate is fitted with a
size for each.
"""

import numpy as np

from surefoot.models.residuals.jacobians import Regressor

OF_EACH_RUN = frozenset(
    {
        "encoder_offset",
        "torque_bias",
        "gyro_bias",
        "accel_bias",
        "reference_delay",
        "clock_scale",
    }
)
"""Effects whose size is another in every run."""


def of_each_run(name: str) -> bool:
    """Whether the effect of this name has another size in every run."""
    return name in OF_EACH_RUN


def deviations(one: Regressor, log: np.ndarray) -> list[Regressor]:
    """How a candidate's size may differ between L logs: L - 1 regressors, whose sizes sum to zero.

    log (M,): which log each bin is from; `one` is by a size that all of them share.
    """
    last = int(log.max(initial=0))
    shares = ((log == i).astype(float) - (log == last) for i in range(last))
    return [Regressor(one.columns, one.values * share[:, None]) for share in shares]
