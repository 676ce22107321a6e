"""Table of residuals of a log under a model: the columns of each channel, and their values."""

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from surefoot.models.residuals.binning import ReferenceMotion
from surefoot.models.residuals.channel import Column, ResidualInputs
from surefoot.models.residuals.channels import channels
from surefoot.sim.log import Log
from surefoot.sim.robot.limbs import Limbs
from surefoot.sim.robot.machine import Machine
from surefoot.sim.sensors.streams import Sensors


@dataclass(frozen=True)
class Layout:
    """The W columns of a residual table, channel after channel.

    Attributes:
        limbs: of the machine.
        columns: all columns.
        channels: name -> slice of columns.
    """

    limbs: Limbs
    columns: tuple[Column, ...]
    channels: dict[str, slice]

    @property
    def width(self) -> int:
        return len(self.columns)

    @cached_property
    def names(self) -> tuple[str, ...]:
        return tuple(column.name for column in self.columns)

    @cached_property
    def channel_of(self) -> tuple[str, ...]:
        """Channel of each column."""
        return tuple(n for n, at in self.channels.items() for _ in range(at.start, at.stop))

    @cached_property
    def kinds(self) -> tuple[tuple[str, str], ...]:
        """Channel and kind of each column, which tell its noise."""
        return tuple(zip(self.channel_of, (one.kind for one in self.columns), strict=True))

    @cached_property
    def groups(self) -> tuple[list[int], ...]:
        """Columns that come from one reading."""
        return self._collected("group")

    @cached_property
    def alike(self) -> tuple[list[int], ...]:
        """Columns with the same noise level."""
        return self._collected("kind")

    @cached_property
    def masked_by(self) -> tuple[tuple[str, ...], ...]:
        """What invalidates each column (see `Channel.masked_by`)."""
        return tuple(channels()[name].masked_by for name in self.channel_of)

    @cached_property
    def fitted(self) -> np.ndarray:
        """Columns that effects are fitted to, without channels that are only evaluated."""
        return self.of(*(name for name in self.channels if not channels()[name].evaluation_only))

    def noise(self, rate: float, evenness: float = 0.0) -> np.ndarray:
        """Standard deviation (W,) of a bin's residual from the sensors' noise by their data sheets
        at a rate [Hz], and from uneven ground (`evenness` [m]).
        """
        every, sensors = channels(), Sensors()
        return np.array([every[name].noise(sensors, rate, evenness) for name in self.channel_of])

    @cached_property
    def least_noise(self) -> np.ndarray:
        """Smallest noise (W,) that columns may have."""
        return np.array([channels()[name].least_noise for name in self.channel_of])

    def of(self, *names: str) -> np.ndarray:
        """Columns of those of these channels that the layout has."""
        places = [self.channels[n] for n in names if n in self]
        return np.concatenate([np.arange(p.start, p.stop) for p in (slice(0, 0), *places)])

    def by_leg(self, name: str) -> np.ndarray:
        """Columns (legs, n) of a channel, by foot."""
        own, legs = self.of(name), len(self.limbs.legs)
        return np.array([[c for c in own if self.columns[c].leg == leg] for leg in range(legs)])

    def __contains__(self, name: str) -> bool:
        return name in self.channels

    def _collected(self, what: str) -> tuple[list[int], ...]:
        found: dict[tuple[str, str], list[int]] = {}
        for c, name in enumerate(self.channel_of):
            found.setdefault((name, getattr(self.columns[c], what)), []).append(c)
        return tuple(found.values())


@lru_cache
def layout_for(limbs: Limbs) -> Layout:
    """Layout of the table for a machine with these legs and joints."""
    columns: list[Column] = []
    places: dict[str, slice] = {}
    for name, channel in channels().items():
        if limbs.feet_alone and not channel.on_given_feet:
            continue
        own = channel.columns(limbs)
        if own:
            places[name] = slice(len(columns), len(columns) + len(own))
            columns += own
    return Layout(limbs, tuple(columns), places)


@dataclass(frozen=True)
class ResidualTable:
    """Residuals of a log, and what their derivatives need again.

    Attributes:
        layout: of the table.
        inputs: from which it was computed.
        table: residuals (M, W).
        names: of the channels that were computed.
    """

    layout: Layout
    inputs: ResidualInputs
    table: np.ndarray
    names: tuple[str, ...]

    @property
    def t(self) -> np.ndarray:
        """Mean time of each bin (M,) [s]."""
        return self.inputs.motion.t


def residual(
    log: Log, robot: Machine, motion: ReferenceMotion, names: Collection[str] | None = None
) -> ResidualTable:
    """Residuals of a log's readings under the model `robot`.

    `names` selects the channels, by default all.
    """
    layout, inputs = layout_for(robot.limbs), ResidualInputs(log, robot, motion)
    asked = tuple(layout.channels if names is None else names)
    return ResidualTable(layout, inputs, filled(layout, inputs, asked), asked)


def filled(layout: Layout, inputs: ResidualInputs, names: Collection[str]) -> np.ndarray:
    """The table (M, W) with the residuals of these channels; NaN in the others."""
    table = np.full((len(inputs.motion.t), layout.width), np.nan)
    for name, columns in layout.channels.items():
        if name in names and channels()[name].is_defined_for(inputs.log, inputs.motion):
            values = channels()[name].residual(inputs)
            if values is not None:
                np.copyto(table[:, columns], values, casting="same_kind")  # no complex numbers
    return table
