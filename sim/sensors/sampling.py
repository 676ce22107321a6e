"""Resampling of a simulated log to a lower rate, like that of a real robot."""

import numpy as np
import pandas as pd


def sampled(frame: pd.DataFrame, rate: float, averages: bool) -> pd.DataFrame:
    """The columns of a simulated log at `rate` [Hz], which is below the simulated one.

    Angles, forces and reference are interpolated to the new times, contacts keep their last value.
    If `averages`, the IMU gives means over the new samples, which avoids aliasing and keeps
    integrals; else its filtered reading at that time.
    """
    t = frame["t"].to_numpy()
    before = 2.0 * t[0] - t[1]
    then = before + np.arange(1, int(np.floor((t[-1] - before) * rate + 1e-6)) + 1) / rate
    held = np.searchsorted(t, then + 1e-9, side="right") - 1
    edges, first = np.append(before, then), np.append(before, t)
    columns: dict[str, np.ndarray] = {"t": then}
    for name in map(str, frame.columns[1:]):
        x = frame[name].to_numpy()
        if name.startswith("contact_"):
            columns[name] = x[held]
        elif averages and name.startswith(("gyro_", "accel_")):
            # A row is the mean since the one before it, so the integral is exact at the rows.
            integral = np.append(0.0, np.cumsum(x * np.diff(first)))
            columns[name] = np.diff(np.interp(edges, first, integral)) * rate
        else:
            columns[name] = np.interp(then, t, x)
    found = pd.DataFrame(columns)
    q = [f"ref_q_{axis}" for axis in "wxyz"]
    # A quaternion's sign may change from row to row: the row before decides.
    ref = _continuous(frame[q].to_numpy())
    turned = np.column_stack([np.interp(then, t, x) for x in ref.T])
    found[q] = turned / np.linalg.norm(turned, axis=1, keepdims=True)
    return found


def _continuous(q: np.ndarray) -> np.ndarray:
    """Quaternions (N, 4) without changes of sign."""
    flips = np.cumprod(np.append(1.0, np.where(np.sum(q[1:] * q[:-1], axis=1) < 0.0, -1.0, 1.0)))
    return q * flips[:, None]
