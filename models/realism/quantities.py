"""Quantities of the realism card.

Each has a value for every stride, stance or second of a walk, and a statistic that combines them.
The interval of the statistic is found by resampling strides.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.signal import butter, periodogram, sosfiltfilt
from scipy.stats import median_abs_deviation

from surefoot.models.calibration.mixing import mixing
from surefoot.models.realism.walk_view import WalkView
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.common.series import interpolate_rows

RIPPLE = 20.0
"""Hz above which a joint's rate counts as ripple; strides and swings are far slower."""
FREQUENCIES = np.arange(1.0, 151.0)
"""Hz, bins of the spectra: pieces of one second resolve 1 Hz at any rate."""
LINES = (20.0, 45.0)
"""Hz, the band in which landing feet and loaded legs ring."""
_RINGING = slice(int(LINES[0]) - 1, int(LINES[1]))
POWER = 0.95
"""Share of a spectrum's power that lies below its bandwidth."""
MEAN_PIECE = 6.0
"""s, length of the pieces whose mixing time is estimated: a dozen strides."""
SPACING = 0.01
"""s between the errors whose mixing time is estimated: the rate of observers."""
PARTS = {"landing": (0.0, 0.2), "middle": (0.2, 0.8), "lift-off": (0.8, 1.0)}
"""Shares of a stance."""
DIRECTIONS_OF_FEET = ("forward", "outward", "up")
WEIGHED = (0.8, 1.25)
"""Range of the mean sum of all foot forces, relative to the weight, in which the forces are taken
to be in newtons.
"""

Values = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Quantity:
    """One statistic of a walk.

    Attributes:
        name: of the quantity.
        unit: of the statistic.
        values: function from a walk to values (K, ...) and the time of each (K,) [s]; raises
            SurefootError where the log lacks what it needs.
        statistic: function from such values to a number.
    """

    name: str
    unit: str
    values: Callable[[WalkView], Values]
    statistic: Callable[[np.ndarray], float]


def duty(walk: WalkView) -> Values:
    """Duty factor: share of each stride for which the foot is sensed to stand."""
    each = np.concatenate(walk.strides)
    return (each[:, 1] - each[:, 0]) / (each[:, 2] - each[:, 0]), each[:, 0]


def period(walk: WalkView) -> Values:
    """Stride period [s], from landing to landing."""
    each = np.concatenate(walk.strides)
    return each[:, 2] - each[:, 0], each[:, 0]


def period_change(walk: WalkView) -> Values:
    """Differences between successive stride periods of a foot, relative to their median.

    Insensitive to slow changes of the gait.
    """
    changes, times = [], []
    for one in walk.strides:
        length = one[:, 2] - one[:, 0]
        next_to = np.flatnonzero(one[1:, 0] == one[:-1, 2])
        changes.append((length[next_to + 1] - length[next_to]) / np.median(length))
        times.append(one[next_to, 2])
    return np.concatenate(changes), np.concatenate(times)


def most_feet_down(walk: WalkView) -> Values:
    """Share of each stride in which more than half of the feet stand."""
    return _by_stride(walk, walk.log.contact.sum(axis=1) > len(walk.strides) / 2)


def all_feet_down(walk: WalkView) -> Values:
    """Share of each stride in which all feet stand."""
    return _by_stride(walk, np.asarray(walk.log.contact.all(axis=1)))


def foothold_change(walk: WalkView, axis: int) -> Values:
    """Differences of a foot's successive footholds in the heading frame, from the IMU [m]."""
    log, changes, times = walk.log, [], []
    R_HI = np.einsum("nij,njk->nik", walk.heading, log.ref_R_GI)
    for leg, one in enumerate(walk.strides):
        rows = np.searchsorted(log.t, one[:, 0])
        feet = walk.robot.feet_I(log.q[rows])[:, leg]
        place = np.einsum("nij,nj->ni", R_HI[rows], feet)[:, axis]
        changes.append(np.diff(place))
        times.append(one[1:, 0])
    return np.concatenate(changes), np.concatenate(times)


def standing_speed(walk: WalkView, part: str, axis: int) -> Values:
    """Mean apparent speed [m/s] of a standing foot over the ground, in a part of its stance.

    See `WalkView.standing_velocity`; sideways, outward is positive.
    """
    low, high = PARTS[part]
    v, inside = walk.standing_velocity, (walk.phase >= low) & (walk.phase < high)
    sign = walk.outward if axis == 1 else np.ones(len(walk.outward))
    means, times = [], []
    for leg, (first, end) in enumerate(walk.stances):
        speed = np.where(inside[:, leg], v[:, leg, axis], np.nan) * sign[leg]
        means.append(_mean_of_runs(speed, first, end))
        times.append(walk.log.t[first])
    return _known(np.concatenate(means), np.concatenate(times))


def walk_stance_means(walk: WalkView) -> Values:
    """Forward speed of the base, and how much of it the leg's kinematics miss, for each stance (K,
    2) [m/s].
    """
    found, times = [], []
    for leg, (first, end) in enumerate(walk.stances):
        missed = _mean_of_runs(walk.standing_velocity[:, leg, 0], first, end)
        known = np.isfinite(walk.standing_velocity[:, leg, 0])
        speed = _mean_of_runs(np.where(known, walk.velocity[:, 0], np.nan), first, end)
        found.append(np.column_stack([speed, missed]))
        times.append(walk.log.t[first])
    return _known(np.concatenate(found), np.concatenate(times))


def missed_share(values: np.ndarray) -> float:
    """Share of the speed that the legs miss: slope through the origin of `walk_stance_means` (K,
    2).
    """
    speed, missed = values.T
    return float(speed @ missed / (speed @ speed))


def missed_spread(values: np.ndarray) -> float:
    """Robust standard deviation [m/s] of the missed speed about that share (K, 2)."""
    speed, missed = values.T
    return spread(missed - missed_share(values) * speed)


def forces_of_stances(walk: WalkView) -> Values:
    """Largest force of each stance, that in its last row, and the median of its middle half (K, 3).

    Stances too short, or not loaded, are left out.
    """
    walk.log.require("force")
    found, times = [], []
    for leg, stances in enumerate(walk.stances):
        for first, end in zip(*stances, strict=True):
            force, quarter = walk.log.force[first:end, leg], (end - first) // 4
            middle = np.median(force[quarter:-quarter]) if quarter else 0.0
            if middle > 0.0:
                found.append((force.max(), force[-1], middle))
                times.append(walk.log.t[first])
    return np.array(found).reshape(-1, 3), np.array(times)


def over_middle(forces: np.ndarray, column: int) -> float:
    """Median ratio of a column of `forces_of_stances` (K, 3) to the middle."""
    return float(np.median(forces[:, column] / forces[:, 2]))


def force_weight(walk: WalkView) -> Values:
    """Largest force of each stance over the robot's weight.

    Raises SurefootError where the feet's forces do not add up to about the weight, so that their
    unit cannot be the newton.
    """
    weight = walk.robot.mass * GRAVITY
    forces, times = forces_of_stances(walk)
    total = float(walk.log.force[walk.walks].sum(axis=1).mean() / weight)
    if not WEIGHED[0] < total < WEIGHED[1]:
        raise SurefootError(
            f"forces are not in newton: their mean sum is {total:.2f} of the weight's {weight:.0f}"
        )
    return forces[:, 0] / weight, times


def joint_ripple(walk: WalkView, kind: int) -> Values:
    """Mean square [rad^2/s^2] by stride of joint rates above RIPPLE; 0 hip, 1 thigh, 2 calf."""
    rate = walk.log.rate
    if rate < 4.0 * RIPPLE:
        raise SurefootError(f"the log's {rate:g} Hz do not show what is above {RIPPLE:g} Hz")
    high = butter(4, RIPPLE, "highpass", fs=rate, output="sos")
    square = sosfiltfilt(high, walk.dq[:, kind::3], axis=0) ** 2
    return _by_stride(walk, square.mean(axis=1))


def sway(walk: WalkView, axis: int) -> Values:
    """Mean square [rad^2/s^2] by stride of the base's rate about its own axis (0 roll, 1 pitch)."""
    rate = walk.log.gyro @ walk.robot.R_BI[axis]
    return _by_stride(walk, rate**2)


def forward_speed(walk: WalkView) -> Values:
    """Mean forward speed of each stride [m/s]."""
    return _by_stride(walk, walk.velocity[:, 0])


def spectra(walk: WalkView, sensor: str, axis: int | None = None) -> Values:
    """Power spectral densities (K, len(FREQUENCIES)) of `gyro` or `accel`, summed over the axes, or
    along one axis of the base: forward, left, up.

    [unit^2/Hz], one for each second of walk, overlapping by half; NaN above half the log's rate.
    """
    reading = getattr(walk.log, sensor)
    if axis is not None:
        reading = (reading @ walk.robot.R_BI[axis])[:, None]
    n = round(walk.log.rate)
    rows = np.flatnonzero(walk.walks)
    first = rows[0] + np.arange(0, rows[-1] - rows[0] - n + 1, n // 2)
    if not len(first):
        raise SurefootError("less than a second of walk")
    pieces = reading[first[:, None] + np.arange(n)]
    # Pieces are a second long, so that bins are 1 Hz apart.
    window: Any = np.hanning(n)  # scipy's type hints know windows by name alone
    power = np.asarray(periodogram(pieces, n, window, axis=1)[1]).sum(axis=2)
    found = np.full((len(first), len(FREQUENCIES)), np.nan)
    shown = min(len(FREQUENCIES), power.shape[1] - 1)
    found[:, :shown] = power[:, 1 : shown + 1]
    return found, walk.log.t[first]


def bandwidth(spectrum: np.ndarray) -> float:
    """Frequency [Hz] below which the share POWER of the mean of spectra (K, F) lies."""
    mean = np.nan_to_num(spectrum.mean(axis=0))
    cumulated = np.cumsum(mean) / mean.sum()
    return float(np.interp(POWER, cumulated, FREQUENCIES))


def line(spectrum: np.ndarray) -> float:
    """Frequency [Hz] of the highest peak of the mean of spectra (K, F) within LINES."""
    return float(FREQUENCIES[_RINGING][np.argmax(spectrum.mean(axis=0)[_RINGING])])


def ringing(spectrum: np.ndarray) -> float:
    """Root mean square of the signal within LINES, from spectra (K, F)."""
    return float(np.sqrt(spectrum.mean(axis=0)[_RINGING].sum()))


def all_power(spectrum: np.ndarray) -> float:
    """Root mean square of the signal up to 150 Hz, or half the log's rate, from spectra (K, F)."""
    return float(np.sqrt(np.nansum(spectrum.mean(axis=0))))


def mixing_time(walk: WalkView) -> Values:
    """Mixing time [s] of leg odometry's velocity errors, in half-overlapping pieces of MEAN_PIECE.

    That is the time after which errors are about independent (`models.calibration.mixing`).
    """
    rows = np.flatnonzero(np.isfinite(walk.standing_velocity[..., 0]).sum(axis=1))
    error = np.nanmean(walk.standing_velocity[rows], axis=1)
    t = walk.log.t[rows]
    every = np.arange(t[0], t[-1], SPACING)
    error = interpolate_rows(every, t, error)
    n = round(MEAN_PIECE / SPACING)
    starts = range(0, len(every) - n + 1, n // 2)
    if not starts:
        raise SurefootError(f"less than {MEAN_PIECE:g} s of walk")
    times = np.array([mixing(error[i : i + n]).K * SPACING for i in starts])
    return times, every[list(starts)]


def spread(values: np.ndarray) -> float:
    """Robust standard deviation, by the median absolute deviation."""
    return float(median_abs_deviation(values, scale="normal"))  # pyright: ignore[reportArgumentType]


def change_spread(values: np.ndarray) -> float:
    """Robust standard deviation of independent values whose successive differences are `values`."""
    return spread(values) / np.sqrt(2.0)


def root_mean(values: np.ndarray) -> float:
    """Root of the mean of values (K,) that are squares already."""
    return float(np.sqrt(values.mean()))


def _mean_of_runs(values: np.ndarray, first: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Means (K,) of values (N,) over rows first[k]:end[k], NaN ignored; NaN where all are."""
    known = np.isfinite(values)
    total = np.concatenate([[0.0], np.cumsum(np.where(known, values, 0.0))])
    count = np.concatenate([[0], np.cumsum(known)])
    n = count[end] - count[first]
    return np.where(n > 0, (total[end] - total[first]) / np.maximum(n, 1), np.nan)


def _known(values: np.ndarray, times: np.ndarray) -> Values:
    """The values (K, ...) that have no NaN, with their times (K,)."""
    known = np.isfinite(values.reshape(len(values), -1)).all(axis=1)
    return values[known], times[known]


def _by_stride(walk: WalkView, values: np.ndarray) -> Values:
    """Means of values (N,) over each stride, while the base moves; empty strides are left out."""
    rows = np.flatnonzero(walk.walks)
    stride = walk.stride_of(walk.log.t[rows])
    count = np.bincount(stride, minlength=len(walk.clock))
    has = count > 0
    return np.bincount(stride, values[rows], len(walk.clock))[has] / count[has], walk.clock[has]


_STEPS = enumerate(DIRECTIONS_OF_FEET[:2])
_SLIPS = [(part, *side) for part in PARTS for side in enumerate(DIRECTIONS_OF_FEET)]
_JOINTS, _AXES = enumerate(("hip", "thigh", "calf")), enumerate(("forward", "lateral", "up"))
_ACCEL = partial(spectra, sensor="accel")
_PEAK, _LAST = partial(over_middle, column=0), partial(over_middle, column=1)
QUANTITIES = (
    Quantity("forward speed", "m/s", forward_speed, np.mean),
    Quantity("stride period", "s", period, np.median),
    Quantity("stride period, jitter", "share", period_change, change_spread),
    Quantity("duty factor", "share", duty, np.median),
    Quantity("more than half of the feet down", "share", most_feet_down, np.mean),
    Quantity("all feet down", "share", all_feet_down, np.mean),
    *(
        Quantity(f"foothold jitter, {name}", "m", partial(foothold_change, axis=i), change_spread)
        for i, name in _STEPS
    ),
    *(
        Quantity(
            f"standing foot, {part}, {name}",
            "m/s",
            partial(standing_speed, part=part, axis=i),
            np.median,
        )
        for part, i, name in _SLIPS
    ),
    Quantity("speed missed by standing legs", "share", walk_stance_means, missed_share),
    Quantity("the same, stance to stance", "m/s", walk_stance_means, missed_spread),
    Quantity("foot force, peak to middle", "ratio", forces_of_stances, _PEAK),
    Quantity("foot force, peak to weight", "ratio", force_weight, np.median),
    Quantity("foot force, threshold to middle", "ratio", forces_of_stances, _LAST),
    *(
        Quantity(f"joint rate ripple, {name}", "rad/s", partial(joint_ripple, kind=i), root_mean)
        for i, name in _JOINTS
    ),
    *(
        Quantity(f"accelerometer, {name}", "m/s^2", partial(_ACCEL, axis=i), all_power)
        for i, name in _AXES
    ),
    Quantity("accelerometer, line", "Hz", _ACCEL, line),
    Quantity("accelerometer, 20 to 45 Hz", "m/s^2", _ACCEL, ringing),
    Quantity("accelerometer, bandwidth", "Hz", _ACCEL, bandwidth),
    Quantity("gyro, bandwidth", "Hz", partial(spectra, sensor="gyro"), bandwidth),
    Quantity("roll rate", "rad/s", partial(sway, axis=0), root_mean),
    Quantity("pitch rate", "rad/s", partial(sway, axis=1), root_mean),
    Quantity("mixing time of leg velocity errors", "s", mixing_time, np.median),
)
"""The quantities of the realism card, in its order."""
