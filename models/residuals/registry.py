"""The residual channels there are: those that come with surefoot, then users' own."""

from functools import cache

from surefoot.models.residuals import channels as bundled
from surefoot.models.residuals.channel import Channel
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.plugins import load_plugins

GROUP = "surefoot.channels"
"""Entry points by which users' packages offer channels of their own."""
BUNDLED: tuple[type[Channel], ...] = (
    bundled.ImuGyro,
    bundled.ImuAccel,
    bundled.LegVelocity,
    bundled.FootHeight,
    bundled.JointTorque,
    bundled.BaseWrench,
    bundled.JointRate,
    bundled.ContactTiming,
)


@cache
def channels() -> dict[str, Channel]:
    """Name -> channel. Raises SurefootError, naming the plugin, where one is no channel."""
    known = {kind.name: kind for kind in BUNDLED}
    found: dict[str, Channel] = {}
    for name, kind in load_plugins(GROUP, known, needs=("name", "unit", "needs")).items():
        if not issubclass(kind, Channel) or kind.name != name:
            raise SurefootError(
                f"plugin {name} ({GROUP}): must be a subclass of Channel whose name is {name!r}"
            )
        found[name] = kind()
    return found
