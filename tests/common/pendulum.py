"""A pendulum that is driven about, with what its drive hides."""

from collections.abc import Sequence

import mujoco
import numpy as np
import pandas as pd

from surefoot.sim.log import Log, Meta
from surefoot.sim.robot.machine import load_machine

DT = 0.002  # s


def swung(
    scale: float = 1.0,
    friction: float = 0.0,
    armature: float = 0.0,
    seed: int = 0,
    seconds: float = 12.0,
    pushes: Sequence[float] = (),
) -> Log:
    """The bundled pendulum driven about, with what its drive hides; read as coarsely as real ones.

    pushes [s]: when a hand turns it back with 3 N m that the drive does not report.
    """
    machine = load_machine("ak80_pendulum")
    spec = mujoco.MjSpec.from_file(str(machine.file))
    spec.option.timestep = DT / 4
    spec.joint("shoulder").frictionloss = friction
    spec.joint("shoulder").armature = armature
    model = spec.compile()
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    rates, phases = rng.uniform(1.0, 6.0, 4), rng.uniform(0.0, 6.0, 4)
    rows = []
    for k in range(round(seconds / DT)):
        torque = 0.9 * np.sin(rates * k * DT + phases).sum()
        hand = -3.0 if any(0.0 <= k * DT - one < 0.15 for one in pushes) else 0.0
        data.qfrc_applied[0] = torque + hand
        rows.append((k * DT, data.qpos[0], data.qvel[0], torque * scale))
        mujoco.mj_step(model, data, 4)
    t, q, dq, tau = np.array(rows).T
    step = 2.9e-3  # rad, of the real drive's encoder
    frame = pd.DataFrame({
        "t": t, "q_shoulder": step * np.round(q / step),
        "dq_shoulder": dq + rng.normal(0, 0.1, len(t)),
        "tau_shoulder": tau + rng.normal(0, 0.2, len(t)),
    })  # fmt: skip
    return Log(frame, Meta(rate=1 / DT, robot="ak80_pendulum"), "swung")
