"""Effects that a real robot has and a model may lack: one small class each."""

from dataclasses import dataclass
from typing import Any, ClassVar

import mujoco

from sim.robot import Robot
from sim.sensors import Streams


@dataclass(frozen=True)
class Effect:
    """One effect on one target (a joint, leg, axis or "all"), of one scalar size.

    A subclass says its name, unit and bounds, which residual channels it can touch, and how it is put into
    the simulation: by editing the MjSpec, or on the sensor streams.
    """

    target: str
    value: float

    name: ClassVar[str]
    unit: ClassVar[str]
    bounds: ClassVar[tuple[float, float]]
    channels: ClassVar[tuple[str, ...]]

    def edit_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Change the simulated world; most effects of sensors do not."""

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        """Change what the sensors see; most effects of the world do not."""
        return streams

    def as_dict(self) -> dict[str, Any]:
        return {"name": self.name, "target": self.target, "value": self.value, "unit": self.unit}
