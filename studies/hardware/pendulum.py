"""Study of one AK80-6 drive that swings a point mass: which effects does its rigid model lack?

Each run is held out once: terms are selected and fitted on the others, and evaluated on it.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from studies.hardware.drives import (
    EFFECTS,
    RIVALS,
    Balance,
    Sizes,
    balance,
    between,
    fit_sizes,
    left,
    level_interval,
    rms,
    select,
)
from surefoot import Log
from surefoot.extend import Modelled
from surefoot.scenarios.reporting import AFTER, BEFORE, INK, legend_below, new_figure, set_title

PENDULUM_WIDTH = 0.04
"""Width of the kernel [s]: short compared with a quarter of a swing, long compared with a row."""
MODELS = {
    "torque scale, dry friction, armature": ("torque_scale", "coulomb_friction", "armature"),
    "without the torque scale": ("coulomb_friction", "armature"),
    "without dry friction": ("torque_scale", "armature"),
    "without armature": ("torque_scale", "coulomb_friction"),
    "heavier rod instead of torque scale": ("gravity", "inertia", "coulomb_friction"),
    "viscous instead of dry friction": ("torque_scale", "viscous_friction", "armature"),
    "friction by load instead of dry": ("torque_scale", "load_friction", "armature"),
    "and viscous friction": ("torque_scale", "coulomb_friction", "armature", "viscous_friction"),
    "and a torque bias": ("torque_scale", "coulomb_friction", "armature", "torque_bias"),
    "and a torque delay": ("torque_scale", "coulomb_friction", "armature", "torque_delay"),
    "every term": (*EFFECTS, *RIVALS),
}
"""Explanations that are compared on runs that no fit has seen."""


@dataclass(frozen=True)
class HeldOut:
    """One run, evaluated with the effects fitted on the other runs."""

    run: Balance
    sizes: Sizes
    before: np.ndarray  # (N,) N m
    after: np.ndarray


def held_out_runs(logs: Mapping[str, Log], machine: Modelled, seed: int = 0) -> tuple[HeldOut, ...]:
    """Evaluate each run with the terms selected and fitted on the others."""
    rng = np.random.default_rng(seed)
    runs = {name: balance(log, machine, PENDULUM_WIDTH) for name, log in logs.items()}
    done = []
    for name, run in runs.items():
        others = [other for key, other in runs.items() if key != name]
        sizes = fit_sizes(others, 0, select(others, 0, tuple(EFFECTS)), rng)
        done.append(HeldOut(run, sizes, left(run, 0), left(run, 0, sizes)))
    return tuple(done)


def held_out_table(done: tuple[HeldOut, ...], seed: int = 0) -> pd.DataFrame:
    """One row for each run: root mean square of the residual torque, before and after."""
    rng = np.random.default_rng(seed)
    rows = []
    for one in done:
        own = fit_sizes([one.run], 0, (*EFFECTS, *RIVALS), rng, samples=0)
        before, after = rms(one.before), rms(one.after)
        rows.append(
            {
                "run held out": one.run.name,
                "terms chosen by the other three": ", ".join(one.sizes.names),
                "before [N m]": between(before, level_interval([(one.run, one.before)], rng)),
                "after [N m]": between(after, level_interval([(one.run, one.after)], rng)),
                "explained [%]": f"{100 * (1 - (after / before) ** 2):.0f}",
                "every term, own fit [N m]": f"{rms(left(one.run, 0, own)):.3f}",
                "jitter of the readings [N m]": f"{one.run.floor[0]:.3f}",
                "left out [%]": f"{100 * (1 - one.run.good.mean()):.0f}",
            }
        )
    return pd.DataFrame(rows)


def sizes_table(done: tuple[HeldOut, ...], seed: int = 0) -> pd.DataFrame:
    """Sizes from all runs together, with intervals from blocks, and from each run alone."""
    rng = np.random.default_rng(seed)
    runs = [one.run for one in done]
    names = MODELS["torque scale, dry friction, armature"]
    whole = fit_sizes(runs, 0, names, rng)
    alone = {run.name: fit_sizes([run], 0, names, rng, samples=0).values for run in runs}
    rows = []
    for i, name in enumerate(names):
        digits = 4 if name == "armature" else 3
        row = {
            "effect": name.replace("_", " "),
            "unit": EFFECTS[name],
            "size (95 % interval)": between(whole.values[i], whole.interval[i], digits),
        }
        rows.append(row | {run: f"{values[i]:.{digits}f}" for run, values in alone.items()})
    return pd.DataFrame(rows)


def rivals_table(done: tuple[HeldOut, ...], seed: int = 0) -> pd.DataFrame:
    """One row for each explanation, fitted on three runs and evaluated on the fourth, in turn."""
    rng = np.random.default_rng(seed)
    rows = []
    for words, names in MODELS.items():
        row: dict[str, object] = {"explanation": words}
        for one in done:
            others = [other.run for other in done if other is not one]
            sizes = fit_sizes(others, 0, names, rng, samples=0)
            row[one.run.name] = f"{rms(left(one.run, 0, sizes)):.3f}"
        rows.append(row)
    return pd.DataFrame(rows)


def pendulum_figure(done: tuple[HeldOut, ...]) -> Figure:
    """Figure: torque and residual of each held-out run."""
    drawn, axes = new_figure(len(done), 2, (9.5, 8.0))
    for (torque, rest), one in zip(axes, done, strict=True):
        t, run = one.run.t - one.run.t[0], one.run
        shown = np.where(run.good[:, 0], run.tau[:, 0], np.nan)
        torque.plot(t, shown, color=INK, label="torque as the drive reports it", linewidth=1.8)
        torque.plot(t, run.rigid[:, 0], "--", color=BEFORE, label="needed by the rigid model")
        estimated = run.tau[:, 0] - one.after
        torque.plot(t, estimated, color=AFTER, label="with the effects fitted on the other runs")
        bulk = 1.3 * np.nanmax(np.abs(shown))
        torque.set_ylim(-bulk, bulk)
        torque.set_ylabel("torque [N m]")
        set_title(torque, f"{run.name}: torque")
        rest.plot(t, one.before, "--", color=BEFORE)
        rest.plot(t, one.after, color=AFTER)
        rest.set_ylabel("residual [N m]")
        set_title(rest, f"residual: {rms(one.before):.2f} N m before, {rms(one.after):.2f} after")
    for ax in axes[-1]:
        ax.set_xlabel("time [s]")
    legend_below(drawn, axes[0, 0], 3)
    return drawn
