"""Runs of the study's machines: arms that are driven about, and walks."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, cast

import mujoco
import numpy as np
import pandas as pd

from studies.loads.plan import machine_of, moved_mass, usual_torques
from surefoot import Log, Robot, Scenario, walk
from surefoot.extend import GRAVITY, Effect, Ground, Modelled, Segment, Sensors, Streams
from surefoot.sim.log import Meta
from surefoot.sim.physics.drives import gears_of

RATE = 500.0
"""Rows a second of the arms' logs [Hz]."""
SUBSTEPS = 4
"""Time steps of the simulation in a row."""
SECONDS = 24.0
"""Length of an arm's run [s]."""
ENCODER, RATE_NOISE, TORQUE_NOISE = 1e-4, 5e-3, 5e-3
"""Encoder step [rad]; standard deviations of rates [rad/s] and of torques [of the usual]."""


class Shove(NamedTuple):
    """A force (3,) [N] on the last link of an arm, between two times [s]."""

    begin: float
    end: float
    force: np.ndarray


def run_of(
    name: str, effects: Sequence[Effect], rng: np.random.Generator, pushes: Sequence[Shove] = ()
) -> Log:
    """A run of a machine with these effects, none of them declared."""
    machine = machine_of(name)
    if isinstance(machine, Robot):
        return walk(_course(rng), machine, int(rng.integers(2**31)), effects, declared=False)
    return _driven(machine, effects, rng, pushes)


def _course(rng: np.random.Generator) -> Scenario:
    turns = rng.choice([-1.0, 0.0, 1.0], 6) * rng.uniform(0.3, 0.6, 6)
    segments = tuple(
        Segment(rng.uniform(3.5, 5.0), rng.uniform(0.25, 0.6), turn=float(turn)) for turn in turns
    )
    return Scenario(
        "loads", segments, Ground(rng.uniform(0.7, 1.0)), sensors=Sensors(encoder_offset=2e-3)
    )


def draw_pushes(name: str, plan: Mapping[str, Any], rng: np.random.Generator) -> list[Shove]:
    """Pushes of a hand in a run, in any direction."""
    least, most = plan["pushes"]
    times = rng.uniform(2.0, SECONDS - 3.0, rng.integers(least, most + 1))
    weight = GRAVITY * moved_mass(machine_of(name))
    drawn = [(rng.normal(size=3), rng.uniform(*plan["push"])) for _ in times]
    return [
        Shove(t, t + rng.uniform(*plan["push_time"]), share * weight * x / np.linalg.norm(x))
        for t, (x, share) in zip(times, drawn, strict=True)
    ]


def _driven(
    machine: Modelled,
    effects: Sequence[Effect],
    rng: np.random.Generator,
    pushes: Sequence[Shove],
) -> Log:
    """An arm on a random smooth path, by torques of a controller that knows it, with `tau_ff`."""
    names, steps = machine.joint_names, round(SECONDS * RATE) * SUBSTEPS
    spec, known = mujoco.MjSpec.from_file(str(machine.file)), cast(Robot, machine)
    for one in effects:
        one.edit_spec(spec, known)
    dt = spec.option.timestep = 1.0 / RATE / SUBSTEPS
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    # Of a higher order: its rates are as late as its angles.
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    model = spec.compile()
    data, gears = mujoco.MjData(model), gears_of(model, names)
    mujoco.mj_forward(model, data)
    t = dt * np.arange(steps)
    path = _path(t, len(names), rng)
    late = sum(one.value for one in effects if one.name == "command_delay") / dt
    stiff = 1.0 / model.dof_invweight0
    q, dq, asked, given = np.empty((4, steps, len(names)))
    for k in range(steps):
        q[k], dq[k] = data.qpos, data.qvel
        asked[k] = data.qfrc_bias + stiff * (400.0 * (path[k] - q[k]) - 40.0 * dq[k])
        before = max(k - late, 0.0)
        first, share = int(before), before % 1.0
        given[k] = (1.0 - share) * asked[first] + share * asked[min(first + 1, k)]
        data.qfrc_applied = given[k]
        if gears.share.any():
            model.dof_frictionloss = gears.dry + gears.share * np.abs(given[k])
        data.xfrc_applied[-1, :3] = sum(x.force * (x.begin < t[k] < x.end) for x in pushes)
        mujoco.mj_step(model, data)
    # Torques are constant within a step; at its beginning they are between those around it.
    given[1:], asked[1:] = 0.5 * (given[1:] + given[:-1]), 0.5 * (asked[1:] + asked[:-1])
    rows, none = slice(0, None, SUBSTEPS), np.zeros((steps // SUBSTEPS, 3))
    read = (t[rows], none, none, q[rows], dq[rows], given[rows], asked[rows], none[:, :0])
    streams = Streams(*read)
    for one in effects:
        streams = one.alter_streams(streams, known)
    return _read(machine, streams, rng)


def _path(t: np.ndarray, joints: int, rng: np.random.Generator) -> np.ndarray:
    """Angles (N, J) [rad] of three sines each, up to 1.2 rad from a middle, from rest."""
    rates, phases = rng.uniform(0.6, 4.5, (3, joints)), rng.uniform(0.0, 2 * np.pi, (3, joints))
    size = rng.dirichlet([3.0] * 3, joints).T * rng.uniform(0.6, 1.2, joints)
    waves = size * np.sin(rates * t[:, None, None] + phases)
    return (rng.normal(0.0, 0.3, joints) + waves.sum(axis=1)) * np.minimum(t / 2.0, 1.0)[:, None]


def _read(machine: Modelled, streams: Streams, rng: np.random.Generator) -> Log:
    """The log of noisy sensors."""
    columns, usual = {"t": streams.t}, usual_torques(machine)
    noisy = {
        "q": np.round(streams.q / ENCODER) * ENCODER,
        "dq": streams.dq + RATE_NOISE * rng.normal(size=streams.dq.shape),
        "tau": streams.tau + TORQUE_NOISE * usual * rng.normal(size=streams.tau.shape),
        "tau_ff": streams.tau_ff,
    }
    for group, values in noisy.items():
        names = [f"{group}_{joint}" for joint in machine.joint_names]
        columns |= dict(zip(names, values.T, strict=True))
    return Log(pd.DataFrame(columns), Meta(rate=RATE, robot=machine.name), "run")
