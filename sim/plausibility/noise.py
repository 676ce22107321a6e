"""Noise of streams from row to row, and its largest size, from which other limits follow."""

from collections.abc import Iterator

import numpy as np

from surefoot.sim.importing.columns import UNITS
from surefoot.sim.plausibility.finding import Finding, plausibility_rule
from surefoot.sim.plausibility.view import LogView

NOISE = {"gyro": 0.2, "accel": 2.0, "q": 0.03, "dq": 1.5, "ref_p": 0.01, "foot": 0.005}
"""Largest noise between rows of a sensor that works, by kind [rad/s, m/s^2, rad, rad/s, m, m].

Gyros: data sheets have 0.01 (MPU-6050, 0.05 deg/s behind a filter, 0.005 deg/s/√Hz), logs of a Go1
and a SCALER 0.03 including vibration. Accelerometers: 0.06 (MPU-6050, 400 ug/sqrt(Hz), over 250
Hz), logs of a Go1, a SCALER and an iCub 0.3 to 0.6. Angles: five counts of 10 bits. Rates: one
count of 12 bits in a row of 1 ms. References: motion capture without a rigid body.
"""


@plausibility_rule("noise", beside="t gyro accel dq", when="comparable")
def noisy(view: LogView) -> Iterator[Finding]:
    """Check the noise of gyro, accelerometer and joint rates.

    Third differences hold little of a body's smooth motion.

    Compares: gyro, accelerometer and joint rates with themselves from row to row.
    Threshold: {NOISE[gyro]:g} rad/s, {NOISE[accel]:g} m/s², {NOISE[dq]:g} rad/s (joints).
    Reason: data sheets of IMUs have a twentieth; encoders of 12 bits, read at 1 kHz and not
        filtered, have as much; a body with mass moves smoothly.
    Remedy: leave the log or the column out; of rates, or filter them: surefoot derives them from
        angles, and says so; a filter takes such noise for 0.01 rad/s and 0.1 m/s².
    """
    log, streams = view.log, {}
    cause = "a broken sensor, a drive that chatters, or readings of several samples mixed up"
    if log.has("imu") and view.resolves:
        streams |= {"gyro": log.gyro, "accel": log.accel}
    if log.has("dq") and view.resolves:
        shown = np.isfinite(view.between_samples(log.dq, log.q if log.has("q") else None))
        streams["dq"] = np.where(shown, log.dq, 0.0)
    for kind, x in streams.items():
        # Third differences of white noise have 20 times its variance; the median ignores impacts.
        rough = np.median(np.abs(np.diff(x, n=3, axis=0)), axis=0) / 0.6745 / np.sqrt(20.0)
        over = np.flatnonzero(rough > NOISE[kind])
        if over.size:
            names = log.joints if kind == "dq" else "xyz"
            columns = tuple(f"{kind}_{names[i]}" for i in over)
            seen = f"{rough[over].max():.2f} {next(iter(UNITS[kind]))} from row to row"
            yield Finding(columns, seen, cause)
