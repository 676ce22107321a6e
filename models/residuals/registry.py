"""Registry of the residual channels: the bundled ones, then those of plug-ins."""

from functools import cache
from typing import Any

from surefoot.models.residuals import channels as bundled
from surefoot.models.residuals.channel import Channel
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.plugins import Registry

CHANNEL_GROUP = "surefoot.channels"
"""Entry point group for channels of other packages."""
BUNDLED_CHANNELS: tuple[type[Channel], ...] = (
    bundled.ImuGyro,
    bundled.ImuAccel,
    bundled.LegVelocity,
    bundled.StanceVelocity,
    bundled.StanceDisplacement,
    bundled.FootHeight,
    bundled.JointTorque,
    bundled.BaseWrench,
    bundled.JointRate,
    bundled.ContactTiming,
    bundled.CommandedTorque,
)


def _check(kind: Any) -> None:
    if not (isinstance(kind, type) and issubclass(kind, Channel)):
        raise SurefootError("must be a subclass of Channel")


CHANNELS = Registry(
    CHANNEL_GROUP, {kind.name: kind for kind in BUNDLED_CHANNELS}, ("name", "unit", "needs"), _check
)
"""Name -> class; a plug-in's is imported and checked when it is looked up."""


@cache
def channels() -> dict[str, Channel]:
    """Name -> channel, of those that can be used (see `Registry.usable` for the others)."""
    return {name: kind() for name, kind in CHANNELS.usable()[0].items()}
