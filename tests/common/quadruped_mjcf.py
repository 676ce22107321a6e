"""MJCF of a quadruped as others draw it: other feet, scenes, names, keyframes and motors."""

from collections.abc import Iterable

LEGS = {"br": (-0.2, -0.06), "fr": (0.2, -0.06), "bl": (-0.2, 0.06), "fl": (0.2, 0.06)}
"""Place of each hip [m], in an order that is not ours."""
SPHERE = '<geom type="sphere" pos="0 0 -0.2" size="0.02" mass="0.03"/>'
KNEE = 'axis="0 1 0" range="-2.7 -0.6"'
UNSEEN = 'contype="0" conaffinity="0"'


def quadruped_mjcf(
    foot: str = SPHERE,
    scene: str = "",
    more: str = "",
    torque: float = 40.0,
    trunk: str = 'size="0.2 0.1 0.05" mass="6"',
    knee: str = KNEE,
    places: Iterable[tuple[float, float]] = LEGS.values(),
) -> str:
    """A quadruped of 10 kg with legs of 0.4 m.

    Args:
        foot: shapes at the end of the calf.
        scene: elements of the world before the robot's body.
        more: elements of the model after the actuators.
        torque: limit of every motor [N m].
        trunk: size and mass of its box.
        knee: axis and range of the last hinge of each leg.
        places: of the hips.
    """
    legs = "".join(
        f'<body name="{leg}1" pos="{x} {y} 0"><joint name="{leg}_j1" axis="1 0 0" range="-.8 .8"/>'
        f'<geom type="sphere" size="0.03" mass="0.4" {UNSEEN}/>'
        f'<body name="{leg}2" pos="0 {0.08 if y > 0 else -0.08} 0">'
        f'<joint name="{leg}_j2" axis="0 1 0" range="-1.5 3"/>'
        f'<geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.015" mass="0.6" {UNSEEN}/>'
        f'<body name="{leg}3" pos="0 0 -0.2"><joint name="{leg}_j3" {knee}/>'
        f'<geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.01" mass="0.15" {UNSEEN}/>'
        f"{foot}</body></body></body>"
        for leg, (x, y) in zip(LEGS, places, strict=True)
    )
    motors = "".join(
        f'<motor joint="{leg}_j{j}" ctrlrange="{-torque} {torque}"/>'
        for leg in LEGS
        for j in (1, 2, 3)
    )
    return (
        '<mujoco model="dog"><compiler angle="radian" autolimits="true"/><worldbody>'
        f'{scene}<body name="trunk" pos="0 0 0.4"><freejoint/><geom type="box" {trunk}/>'
        f'<site name="imu"/>{legs}</body></worldbody><actuator>{motors}</actuator>{more}</mujoco>'
    )
