"""How large the residual is, channel by channel: before, after, and with nothing to explain."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.attribution import Attribution, Split
from models.candidates import Case, Evidence, linearise
from models.fitting import fit, whiten
from models.masking import Trust, trust
from models.residual import CHANNELS, COLUMNS

AT_FLOOR = 1.15
"""A channel is at its floor up to this ratio to the root mean square of the floor's worst walk."""
WORSE = 1.02
"""A channel got worse from this ratio of after to before."""


@dataclass(frozen=True)
class Channel:
    """Root mean square residual on the report split, in `unit`; biases of the sensor are taken off.

    None for the floor where no repeat of the declared model has the channel.
    """

    before: float
    after: float
    noise_floor: float | None
    unit: str
    highest: float = np.inf
    """The most that one walk of the floor has."""

    @property
    def at_floor(self) -> bool:
        """Whether what is left is what the declared model leaves by itself."""
        return self.after <= AT_FLOOR * self.highest

    @property
    def worse(self) -> bool:
        """Whether what was added to the model does harm on data that no fit has seen."""
        return self.after > WORSE * self.before


def channel_levels(cases: Sequence[Case], result: Attribution, split: Split) -> dict[str, Channel]:
    """Level of each channel on the report split, with and without the effects found."""
    keys = result.evidence.keys
    plain = linearise(cases, (), keys[:0])
    trusted, floor = result.trust, result.floor
    use = split.fit | split.select
    before = without_bias(plain, trusted, use)
    after = without_bias(result.evidence, trusted, use)
    floors = [
        without_bias(e, trust(e, floor.sigma), np.ones(len(e.t), bool)) for e in floor.evidences
    ]
    channels = {}
    for name, unit in CHANNELS.items():
        columns = COLUMNS[name]
        if not np.isfinite(before[split.report][:, columns]).any():
            continue
        level = [_rms(part[:, columns]) for part in floors]
        channels[name] = Channel(
            before=_rms(before[split.report][:, columns]),
            after=_rms(after[split.report][:, columns]),
            noise_floor=float(np.sqrt(np.mean(np.square(level)))) if level else None,
            unit=unit,
            highest=max(level, default=np.inf),
        )
    return channels


def without_bias(evidence: Evidence, trusted: Trust, use: np.ndarray) -> np.ndarray:
    """The residual table (M, 18) less the sensors' biases as fitted on `use`; slips are NaN."""
    data = whiten(evidence, trusted)
    bias = fit(data.rows(use), ()).sizes
    left = evidence.table - (data.X[:, :, len(data.keys) :] @ bias) * trusted.sigma
    left[:, 6:][np.repeat(trusted.masked, 3, axis=1)] = np.nan
    return left


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(values**2)))
