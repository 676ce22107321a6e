"""A small biped with flat feet, and logs of it: moved by its kinematics, its stance foot standing.

Six hinges a leg (yaw, roll, pitch, knee, ankle pitch and roll), and a hinge in its waist.
"""

from pathlib import Path

import numpy as np
import pandas as pd
from reference_columns import reference_columns
from scipy.spatial.transform import Rotation

from surefoot.sim.log import Log, Meta
from surefoot.sim.log.schema import named_columns
from surefoot.sim.robot import Robot
from surefoot.sim.robot.kinematics import feet
from surefoot.sim.sensors.streams import imu_between_states

LEG = """<body name="{s}_yaw_link" pos="0 {y} -.05"><joint name="{s}_hip_yaw" axis="0 0 1"/>{m}
<body name="{s}_roll_link"><joint name="{s}_hip_roll" axis="1 0 0"/>{m}
<body name="{s}_thigh_link"><joint name="{s}_hip_pitch" axis="0 1 0"/>{m}
<body name="{s}_shank_link" pos="0 0 -.3"><joint name="{s}_knee" axis="0 1 0"/>{m}
<body name="{s}_ankle_link" pos="0 0 -.3"><joint name="{s}_ankle_pitch" axis="0 1 0"/>{m}
<body name="{s}_foot"><joint name="{s}_ankle_roll" axis="1 0 0"/>
<geom type="box" size=".09 .05 .02" pos=".03 0 -.06" mass=".4"/>
</body></body></body></body></body></body>"""
ROD = (
    '<geom type="capsule" fromto="0 0 0 0 0 -.02" size=".03" mass=".5" contype="0" '
    'conaffinity="0"/>'
)
BIPED = """<mujoco model="biped"><worldbody><body name="pelvis" pos="0 0 .73"><freejoint/>
<site name="imu" pos=".02 .01 .05"/><geom type="box" size=".08 .1 .04" mass="5"/>{legs}
<body name="torso" pos="0 0 .05"><joint name="waist" axis="0 0 1"/>
<geom type="box" size=".08 .12 .2" pos="0 0 .25" mass="10"/></body>
</body></worldbody></mujoco>""".format(
    legs="".join(LEG.format(s=side, y=y, m=ROD) for side, y in (("left", 0.08), ("right", -0.08)))
)
RATE, STEP, UNLOADED = 200.0, 0.8, 0.018  # Hz, s of a step, s


def biped(folder: Path) -> Robot:
    """The biped, from a file in `folder`."""
    path = folder / "biped.xml"
    path.write_text(BIPED)
    return Robot.load(path)


def biped_log(robot: Robot, seconds: float = 16.0, built: Robot | None = None, **encoder) -> Log:
    """A walk of the biped: the pelvis sways and turns as it goes, one foot stands at a time and a
    little of each step both do.

    Args:
        robot: as declared, whose name the log has.
        seconds: of the walk.
        built: as built, whose legs stand on the ground; as declared where left out.
        encoder: offset of joints' encoders by name [rad].
    """
    built = robot if built is None else built
    t = np.arange(int(seconds * RATE) + 1) / RATE
    R_GB, p_GB = _pelvis(t)
    placed, contact = _feet(t)
    q = np.zeros((len(t), len(robot.limbs.joints)))
    at_base = R_GB.transpose(0, 2, 1)
    for leg, chain in enumerate(robot.limbs.chains):
        goal = np.einsum("nij,nj->ni", at_base, placed[:, leg] - p_GB)
        q[:, chain] = _reached(built, leg, goal, at_base)
    q[:, robot.limbs.joints.index("waist")] = 0.3 * np.sin(2 * np.pi * 0.4 * t)
    R_GI, p_GI = R_GB @ robot.R_BI, p_GB + R_GB @ robot.p_BI
    v_GI = np.gradient(p_GI, t, axis=0)
    gyro, accel = imu_between_states(t, R_GI, v_GI)
    dq = np.gradient(q, t, axis=0)
    offset = np.array([encoder.get(joint, 0.0) for joint in robot.limbs.joints])
    rng = np.random.default_rng(0)
    columns, joints = {"t": t[1:]}, robot.limbs.joints
    for name, values, noise, parts in (
        ("gyro", gyro, 1e-3, "xyz"),
        ("accel", accel, 2e-2, "xyz"),
        ("q", (q + offset)[1:], 2e-4, joints),
        ("dq", dq[1:], 5e-3, joints),
    ):
        columns |= named_columns(name, values + noise * rng.normal(size=values.shape), parts)
    columns |= named_columns("contact", contact[1:].astype(float), robot.limbs.legs)
    columns |= reference_columns(R_GI[1:], p_GI[1:], v_GI[1:])
    return Log(pd.DataFrame(columns), Meta(rate=RATE, robot=str(robot.file)), "biped")


def _pelvis(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Attitude (N, 3, 3) and place (N, 3) [m] of the pelvis in G."""
    w = np.pi / STEP
    yaw, roll, pitch = 0.15 * np.sin(0.3 * t), 0.03 * np.sin(w * t), 0.05 * np.sin(0.7 * w * t)
    R = Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, roll])).as_matrix()
    p = np.column_stack(
        [0.25 * t, 0.03 * np.sin(w * t), 0.66 + 0.015 * np.cos(2 * w * t) + 0.01 * np.sin(t)]
    )
    return R, p


def _feet(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middles of the soles (N, 2, 3) [m] in G, level and heading along x, and which stand."""
    placed, contact = np.zeros((len(t), 2, 3)), np.zeros((len(t), 2), dtype=bool)
    for leg, y in enumerate((0.08, -0.08)):
        phase = (t / (2 * STEP) + 0.5 * leg) % 1.0
        cycle = np.floor(t / (2 * STEP) + 0.5 * leg)
        share = np.clip((phase - 0.6) / 0.4, 0.0, 1.0)
        # It stands where the pelvis is in the middle of the stance.
        middle = 0.25 * 2 * STEP * (cycle + 0.3 - 0.5 * leg)
        placed[:, leg, 0] = middle + 0.03 + 0.25 * 2 * STEP * share
        placed[:, leg, 1] = y
        placed[:, leg, 2] = 0.05 * np.sin(np.pi * share)
        # A foot that is about to lift is unloaded for a while before it moves.
        contact[:, leg] = phase < 0.6 - UNLOADED / (2 * STEP)
    return placed, contact


def _reached(robot: Robot, leg: int, goal: np.ndarray, level: np.ndarray) -> np.ndarray:
    """Angles (N, 6) [rad] that put a leg's sole at `goal` (N, 3) [m] in B, turned as `level`
    (N, 3, 3), by Newton's method."""
    q = np.zeros((len(goal), len(robot.limbs.joints)))
    chain, missed = list(robot.limbs.chains[leg]), np.full((len(goal), 6), np.inf)
    q[:, chain] = [0.0, 0.0, -0.4, 0.8, -0.4, 0.0]
    for _ in range(8):
        feet_B, J, axes = feet(robot.legs, q, np.eye(3), np.zeros(3))
        turned = np.tile(np.eye(3), (len(q), 1, 1))
        for j, joint in enumerate(chain):
            turned = (
                turned @ Rotation.from_rotvec(q[:, [joint]] * robot.legs.axis[leg, j]).as_matrix()
            )
        apart = Rotation.from_matrix(level @ turned.transpose(0, 2, 1)).as_rotvec()
        missed = np.hstack([goal - feet_B[:, leg], apart])
        by_joint = np.concatenate([J[:, leg], axes[:, leg]], axis=1)
        q[:, chain] += np.linalg.solve(by_joint, missed[..., None])[..., 0]
    assert np.abs(missed).max() < 1e-9
    return q[:, chain]
