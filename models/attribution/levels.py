"""Residual of each channel before and after compensation, and its noise floor."""

from dataclasses import dataclass

import numpy as np

from surefoot.models.attribution.evidence import Evidence
from surefoot.models.attribution.noise_floor import NoiseFloor
from surefoot.models.bootstrap import BLOCK_SECONDS, block_bootstrap_counts
from surefoot.models.residuals.channel import Channel
from surefoot.models.residuals.channels import channels

NOISE_RATIO = 1.5
"""Ratio to the floor from which a channel is above it, at the lower end of its interval."""
WORSE_RATIO = 1.02
"""Ratio of after to before from which a channel is worse."""
REFUTED_RATIO = 1.1
"""Ratio of after to before from which a channel above all walks of its floor is worse, however much
these scatter.
"""


@dataclass(frozen=True)
class ChannelLevel:
    """Root mean square residual of a channel on bins that no fit has seen, in `unit`.

    Turn-on biases are subtracted. The floor is None where no simulated walk has the channel.
    """

    before: float
    after: float
    noise_floor: float | None
    unit: str
    highest: float = np.inf
    """Upper limit of the noise floor: the highest of the simulated walks plus their range and a
    standard error (two of events) or, where noise alone is the floor, two standard errors above it.
    """
    evaluation_only: bool = False
    """Whether no fit uses the channel: it need not reach its floor, but must not get worse."""
    same_bins: tuple[float, float] | None = None
    """Before and after on the bins that both have: compensating contacts changes the stances. Zeros
    where there are none.
    """
    by_chance: bool = False
    """Whether the increase, over a channel's few events, is within chance."""
    low_share: float = 1.0
    """Lower end of the 95 % interval of `after`, by a bootstrap over blocks, as a share of it."""
    of_noise: float = np.inf
    """Largest level that noise and the model's own error explain."""
    on_like_ground: bool = True
    """Whether the ground of the log is level, as that of the floor's walks is."""

    @property
    def at_floor(self) -> bool:
        """Whether the remaining residual is at the noise floor."""
        return self.evaluation_only or self.within_floor

    @property
    def within_floor(self) -> bool:
        """Whether the remaining residual is at the noise floor, even of a channel that no fit
        uses.
        """
        limit = min(self.of_noise, self.highest) if self.on_like_ground else self.of_noise
        return self.low_share * self.after <= limit

    @property
    def worse(self) -> bool:
        """Whether compensation increases the residual on unseen data.

        Judged on the bins that both have. Either the residual reaches REFUTED_RATIO of its value
        before and lies above all walks of the noise floor; or the increase is not by chance,
        exceeds the scatter of walks simulated with these effects, and the residual is above their
        floor.
        """
        before, after = self.same_bins or (self.before, self.after)
        if after > max(REFUTED_RATIO * before, self.highest):
            return True
        if self.by_chance or after <= WORSE_RATIO * before:
            return False
        if self.noise_floor is None:
            return True
        differ = after - before > self.highest - self.noise_floor
        return differ and not self.within_floor


def channel_levels(
    before: np.ndarray,
    after: np.ndarray,
    known: Evidence,
    floor: NoiseFloor,
    on_like_ground: bool = True,
) -> dict[str, ChannelLevel]:
    """Residual of each channel of a table.

    Args:
        before: residual (M, W) of the declared model on unseen bins.
        after: the same with the effects found compensated.
        known: evidence whose columns these are.
        floor: noise floor of the model with the effects.
        on_like_ground: as of `ChannelLevel`.
    """
    floors = [one.left for one in floor.walks]
    levels = {}
    for name, columns in known.layout.channels.items():
        if not np.isfinite(before[:, columns]).any():
            continue
        channel = channels()[name]
        least = channel.least_noise if channel.on_level_ground else 0.0
        level = [
            max(trimmed_rms(part[:, columns], channel), least)
            for part in floors
            if np.isfinite(part[:, columns]).any()
        ]
        own = float(np.sqrt(np.mean(np.square(level)))) if level else None
        most = 2.0 * max(level) - min(level) if level else np.inf
        if level:
            square = np.concatenate([part[:, columns].ravel() for part in floors]) ** 2
            count = np.isfinite(after[:, columns]).sum()
            # A log has few changes of contact, and some are far outliers.
            if channel.of_events:
                most *= 1.0 + 2.0 * scatter_of_rms(_bulk(square, channel), count)
            else:
                most *= 1.0 + scatter_of_rms(_bulk(square, channel), count)
        if own is None and not floor.walks:
            own = float(np.sqrt(np.mean(floor.sigma[columns] ** 2)))
            # Noise of neighbouring bins is correlated, so n bins determine the RMS to about
            # 1/sqrt(n).
            count = np.isfinite(after[:, columns]).sum()
            most = own * (1.0 + 2.0 / float(np.sqrt(max(count, 1))))
        most = max(most, floor.levels.get(name, 0.0))
        both = np.isfinite(before[:, columns]) & np.isfinite(after[:, columns])
        same = (
            [trimmed_rms(part[:, columns][both], channel) for part in (before, after)]
            if both.any()
            else [0, 0]
        )
        levels[name] = ChannelLevel(
            before=trimmed_rms(before[:, columns], channel),
            after=trimmed_rms(after[:, columns], channel),
            noise_floor=own,
            unit=" and ".join(dict.fromkeys(c.unit for c in known.layout.columns[columns])),
            highest=most,
            evaluation_only=channel.evaluation_only,
            same_bins=(same[0], same[1]),
            by_chance=channel.of_events and _by_chance(before[:, columns], after[:, columns]),
            low_share=_low_share(after[:, columns], channel, known),
            of_noise=max(np.inf if own is None else NOISE_RATIO * own, floor.levels.get(name, 0.0)),
            on_like_ground=on_like_ground,
        )
    return levels


def _by_chance(before: np.ndarray, after: np.ndarray) -> bool:
    """Whether the mean paired increase over events is less than two standard errors.

    A few bad touchdowns dominate the RMS.
    """
    more = after**2 - before**2
    more = more[np.isfinite(more)]
    return bool(np.mean(more) <= 2.0 * np.std(more) / np.sqrt(len(more))) if len(more) else True


def block_gains(
    before: np.ndarray, after: np.ndarray, known: Evidence, sigma: np.ndarray, weight: np.ndarray
) -> dict[str, np.ndarray]:
    """Reduction of each block's weighted squared residual (K,) by channel, in units of the noise.

    Args:
        before: residual (M, W) without nuisance parameters; NaN where there is none.
        after: the same with more effects compensated.
        known: evidence whose columns and bins these are.
        sigma: noise of the columns (W,).
        weight: of the entries (M, W).
    """
    stretch = np.floor((known.t - known.t.min()) / BLOCK_SECONDS).astype(int)
    number = known.log * (stretch.max() + 1) + stretch
    gain = np.nan_to_num(weight * (before**2 - after**2)) / sigma**2
    both = np.isfinite(before) & np.isfinite(after) & (weight > 0.0)
    gains = {}
    for name, columns in known.layout.channels.items():
        blocks = np.unique(number[both[:, columns].any(axis=1)])
        if len(blocks):
            each = np.bincount(number, gain[:, columns].sum(axis=1), minlength=number.max() + 1)
            gains[name] = each[blocks]
    return gains


def scatter_of_rms(square: np.ndarray, count: int) -> float:
    """Relative standard deviation of the RMS of `count` independent draws from a distribution.

    sqrt((kurtosis - 1) / (4 count)), the kurtosis by samples (K,) of the distribution's square.
    """
    kurtosis = np.mean(square**2) / max(np.mean(square) ** 2, 1e-300)
    return float(np.sqrt(max(kurtosis - 1.0, 0.0) / (4.0 * max(count, 1))))


def trimmed_rms(values: np.ndarray, channel: Channel) -> float:
    """Root mean square of the finite values without the largest (`_bulk`); NaN without any."""
    return float(np.sqrt(_bulk(values**2, channel).mean()))


def _bulk(square: np.ndarray, channel: Channel) -> np.ndarray:
    """The finite squares without the largest 1 %, of events 10 %.

    A few bins with an impact between two samples would otherwise dominate a torque's RMS, and feet
    that hit an edge or bounce that of contacts.
    """
    square = np.sort(square[np.isfinite(square)])
    return square[: max(1, round((0.9 if channel.of_events else 0.99) * len(square)))]


def _low_share(values: np.ndarray, channel: Channel, known: Evidence) -> float:
    """Lower end of the 95 % interval of the trimmed RMS of values (M, n), by blocks, as a share of
    it.
    """
    square = values**2
    there = np.isfinite(square)
    if not there.any():
        return 1.0
    there &= square <= _bulk(square, channel)[-1]
    block = known.log * 1_000_000 + np.floor(known.t / BLOCK_SECONDS).astype(int)
    rows, block = there.any(axis=1), np.unique(block, return_inverse=True)[1]
    total, count = (
        np.bincount(block[rows], np.where(there, one, 0.0).sum(axis=1)[rows])
        for one in (square, np.ones_like(square))
    )
    drawn = block_bootstrap_counts(int(np.count_nonzero(count)), np.random.default_rng(0))
    mean = (drawn @ total[count > 0]) / np.maximum(drawn @ count[count > 0], 1.0)
    level = np.sum(total) / np.sum(count)
    return float(np.sqrt(np.percentile(mean, 2.5) / level)) if level > 0.0 else 1.0
