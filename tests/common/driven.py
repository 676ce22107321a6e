"""Machines on a fixed base that are driven through sines, and the logs of their noisy sensors."""

from collections.abc import Sequence

import mujoco
import numpy as np
import pandas as pd

from surefoot.sim.effects.base import Effect
from surefoot.sim.log import Log, Meta
from surefoot.sim.robot.machine import Modelled

RATE, SUBSTEPS = 500.0, 5


def driven(
    machine: Modelled,
    effects: Sequence[Effect] = (),
    seconds: float = 10.0,
    scale: float = 0.0,
    load: float = 0.0,
) -> Log:
    """The log of a machine that goes through sines.

    Args:
        machine: it.
        effects: in its MjSpec.
        seconds: length.
        scale: by which its torques are read too large.
        load: friction of its first joint by the torque of its drive.
    """
    spec = mujoco.MjSpec.from_file(str(machine.file))
    for joint in machine.joint_names:
        spec.add_actuator(target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT).set_to_motor()
    for one in effects:
        one.edit_spec(spec, machine)  # pyright: ignore[reportArgumentType]
    spec.option.timestep = 1.0 / RATE / SUBSTEPS
    # A first-order integrator's rates are half a step behind its angles: a delay of 0.1 ms.
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    model, n = spec.compile(), len(machine.joint_names)
    data, rng, rows = mujoco.MjData(model), np.random.default_rng(0), []
    dry, turn = model.dof_frictionloss[0], np.arange(n)
    for k in range(round(seconds * RATE)):
        t = k / RATE
        goal = 1.2 * np.sin(2.0 * t + turn) + 0.6 * np.sin((5.1 + 1.3 * turn) * t + 1.0)
        before = data.ctrl.copy()
        data.ctrl[:] = 20.0 * (goal - data.qpos) - data.qvel
        model.dof_frictionloss[0] = dry + load * abs(data.ctrl[0])
        # At the row's own time the torque is between those of the steps around it.
        torque = 0.5 * (before + data.ctrl) * (1.0 + scale)
        rows.append((t, *data.qpos, *data.qvel, *torque))
        mujoco.mj_step(model, data, SUBSTEPS)
    t, q, dq, tau = np.split(np.array(rows), [1, 1 + n, 1 + 2 * n], axis=1)
    tau, dq = tau + rng.normal(0, 0.02, tau.shape), dq + rng.normal(0, 0.01, dq.shape)
    q = np.round(q / 3.8e-4) * 3.8e-4
    names = ["t", *(f"{group}_{j}" for group in ("q", "dq", "tau") for j in machine.joint_names)]
    frame = pd.DataFrame(np.hstack([t, q, dq, tau]), columns=names)
    return Log(frame, Meta(rate=RATE, robot=machine.name), "driven")
