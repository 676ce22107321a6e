"""An effect of a user's own: one class, named in the package's entry points."""

from dataclasses import replace

from surefoot.extend import JOINTS, Effect, FootRolling, Traced

SHANK = 0.3  # m


class RubberBoots(Effect):
    """Boots thicken every foot, and the knees were zeroed with the boots against a block.

    So each calf's encoder reads an angle of the thickness over the shank's length too much.
    """

    name = "rubber_boots"
    unit = "m"
    bounds = (-0.02, 0.02)
    targets = ("all",)
    traced = Traced(channels=("leg_velocity", "foot_height", "base_wrench"), step=1e-3)

    def edit_spec(self, spec, robot):
        FootRolling("all", self.value).edit_spec(spec, robot)

    def alter_streams(self, streams, robot):
        q = streams.q.copy()
        q[:, [JOINTS.index(joint) for joint in CALVES]] += self.value / SHANK
        return replace(streams, q=q)

    def compensate(self, log, robot):
        columns = {f"q_{j}": log.frame[f"q_{j}"].to_numpy() - self.value / SHANK for j in CALVES}
        known = replace(robot, foot_radius=robot.foot_radius + self.value)
        return replace(log, frame=log.frame.assign(**columns)), known


CALVES = [joint for joint in JOINTS if joint.endswith("_calf")]
