"""Machines on a fixed base, simulated plainly by MuJoCo, and their logs."""

from collections.abc import Callable, Mapping
from pathlib import Path

import mujoco
import numpy as np
import pandas as pd

from surefoot.sim.log import Log, Meta
from surefoot.sim.robot.machine import FixedBase, load_machine

GANTRY = """<mujoco><worldbody><body><joint name="x" type="slide" axis="1 0 0"/>
<geom type="box" size=".05 .5 .05" mass="20"/><body><joint name="z" type="slide" axis="0 0 1"/>
<geom type="box" size=".03 .03 .3" mass="6"/></body></body></worldbody></mujoco>"""
ARM = """<mujoco><worldbody><body pos="0 0 1"><joint name="shoulder" axis="0 1 0" armature=".5"/>
<geom type="capsule" fromto="0 0 0 .45 0 0" size=".05" mass="9"/><body pos=".45 0 0">
<joint name="elbow" axis="0 1 0" armature=".1"/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".04" mass="3"/></body></body></worldbody>
</mujoco>"""
RATE = 250.0  # Hz
SUBSTEPS = 4
ENCODER = 2e-5  # rad or m


def machine(text: str, folder: Path) -> FixedBase:
    """The machine of an MJCF, written into a folder."""
    (folder / "machine.xml").write_text(text)
    one = load_machine(folder / "machine.xml")
    assert isinstance(one, FixedBase)
    return one


def moved(
    one: FixedBase,
    noise: Mapping[str, float],
    edit: Callable[[mujoco.MjSpec], None] = lambda spec: None,
    seed: int = 0,
    seconds: float = 16.0,
) -> Log:
    """A log of the machine following sines.

    Args:
        one: the machine.
        noise: standard deviation of each joint's torque [N m, N].
        edit: puts in what the model lacks.
        seed: of the noise.
        seconds: length.
    """
    spec = mujoco.MjSpec.from_file(str(one.file))
    edit(spec)
    spec.option.timestep = 1.0 / RATE / SUBSTEPS
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    model = spec.compile()
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    mujoco.mj_forward(model, data)
    size = np.where(model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE, 0.2, 0.8)
    joints, rows = np.arange(model.nv), []
    for k in range(round(seconds * RATE * SUBSTEPS)):
        t = k / RATE / SUBSTEPS
        turn = (2.1 + 0.7 * joints) * t, (4.3 + 1.1 * joints) * t
        goal = size * (0.7 * np.sin(turn[0]) + 0.3 * np.sin(turn[1]))
        data.qfrc_applied[:] = (
            data.qfrc_bias + (400.0 * (goal - data.qpos) - 40.0 * data.qvel) / model.dof_invweight0
        )
        if k % SUBSTEPS == 0:
            rows.append(np.concatenate([[t], data.qpos, data.qvel, data.qfrc_applied]))
        mujoco.mj_step(model, data)
    names = [f"{kind}_{joint}" for kind in ("q", "dq", "tau") for joint in one.joint_names]
    frame = pd.DataFrame(np.array(rows), columns=["t", *names])
    for joint in one.joint_names:
        count = len(frame)
        frame[f"q_{joint}"] = np.round(frame[f"q_{joint}"] / ENCODER) * ENCODER
        frame[f"dq_{joint}"] += rng.normal(0.0, 20 * ENCODER, count)
        frame[f"tau_{joint}"] += rng.normal(0.0, noise[joint], count)
    return Log(frame, Meta(rate=RATE, robot=str(one.file)), "moved")
