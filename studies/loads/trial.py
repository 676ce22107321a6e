"""One case of the study: its run, what `trace` says of it, and how that compares with the truth."""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any, cast

import mujoco
import numpy as np

from studies.loads.plan import PLAN, LoadCase, TiedLoad, errors_of, errors_of_run, link, machine_of
from studies.loads.runs import draw_pushes, run_of
from surefoot import Log, Robot, Trace, TraceOptions, load_machine, trace
from surefoot.extend import Effect, Modelled, read_toml
from surefoot.models.attribution.evidence import log_under_model, table_of
from surefoot.models.attribution.metric import metric_of
from surefoot.models.attribution.model_error import PER_RUN, ModelError, evidence_of
from surefoot.models.residuals.layout import layout_for
from surefoot.scenarios.trace.run import unchanged_beside
from surefoot.sim.effects.file import load_effects

CLAIMS = ("attributed", "confounded", "no_residual")
"""Verdicts by which nothing else is missing."""
WORSE, LEFT = 1.05, 1.5
"""Ratios of a held-out residual: to that without the effects found, from which these are refuted,
and to that with the true ones, from which a verdict of CLAIMS is.
"""


def run_load_case(case: LoadCase, plan: Path = PLAN) -> dict[str, Any]:
    """Simulate and trace one case; returns its truth and what was found as plain JSON types."""
    begin = process_time()
    fixed = case.individual is None
    result = _of_fixed(case, read_toml(plan, "study")) if fixed else _since(case, plan)
    return {
        "number": case.number,
        "kind": case.kind,
        "machine": case.machine,
        "individual": case.individual,
        "effects": [one.as_dict() for one in case.effects],
        **result,
        "cpu": round(process_time() - begin, 1),
    }


def _since(case: LoadCase, plan: Path) -> dict[str, Any]:
    """What changed in a run since others that the machine was calibrated on."""
    machine, drawn = machine_of(case.machine), read_toml(plan, "study")
    verdict, declared, since = calibrated(case.machine, case.individual or 0, plan)
    log = _run(case, drawn, np.random.default_rng([drawn["seed"], case.number]))
    found = traced_run([log], machine, TraceOptions(declared=declared, since=since))
    out = _said(found) | {"calibration": verdict, "declared": len(declared)}
    if case.kind != "load" or since is None:
        return out
    return out | {"over_least": over_least(case.effects[0], found, log, declared, since)}


@lru_cache(maxsize=2)
def calibrated(
    name: str, individual: int, plan: Path
) -> tuple[str, tuple[Effect, ...], ModelError | None]:
    """Verdict and effects of some runs of a machine, and how its model errs in them."""
    drawn = read_toml(plan, "study")
    runs = [
        _run(
            LoadCase(-1, "unchanged", name, individual),
            drawn,
            _rng(drawn, name, individual, 1 + run),
        )
        for run in range(drawn["loads"]["runs"])
    ]
    with TemporaryDirectory() as folder:
        verdict = trace(runs, machine_of(name), folder).verdict
        file = Path(folder) / "effects.toml"
        declared = tuple(load_effects(file))
        return verdict, declared, unchanged_beside(file, declared)


def _run(case: LoadCase, plan: Mapping[str, Any], rng: np.random.Generator) -> Log:
    """A run of an individual with the case's effects."""
    machine = machine_of(case.machine)
    errors = errors_of(machine, _rng(plan, case.machine, case.individual or 0, 0))
    zeros = [] if isinstance(machine, Robot) else errors_of_run(machine, rng)
    return run_of(case.machine, [*errors, *zeros, *case.effects], rng)


def _rng(plan: Mapping[str, Any], name: str, individual: int, run: int) -> np.random.Generator:
    return np.random.default_rng([plan["seed"], *name.encode(), individual, run])


def traced_run(logs: Sequence[Log], machine: Modelled, options: TraceOptions) -> Trace:
    """`trace` into a folder that is not kept."""
    with TemporaryDirectory() as folder:
        return trace(logs, machine, folder, options)


def _said(found: Trace) -> dict[str, Any]:
    said = found.as_dict()
    kept = {key: said.get(key, []) for key in ("verdict", "reasons", "rivals", "channels")}
    return kept | {"effects_found": said["effects"]}


def over_least(
    load: Effect, found: Trace, log: Log, declared: Sequence[Effect], since: ModelError
) -> float | None:
    """How clearly a load shows, as a multiple of the least change that would have been named.

    The load's squared size under the covariance of unchanged runs is that of so much mass at the
    link's centre; this mass is divided by the least one.

    Args:
        load: that was tied on.
        found: what `trace` says.
        log: the run.
        declared: effects of the model.
        since: its error in the unchanged runs.
    """
    assert isinstance(load, TiedLoad)
    machine = machine_of(log.meta.robot)
    case = log_under_model(log, machine, declared)
    known, _ = evidence_of([case])
    every = np.ones(len(known.t), dtype=bool)
    S = metric_of([case], known, since, every, PER_RUN, not case.fixed).S
    sizes = load_sizes(load, machine)
    use = [1 + known.keys.index(key) for key in sizes if key in known.keys]
    x = np.array([size for key, size in sizes.items() if key in known.keys])
    shown = np.sqrt(x @ S[np.ix_(use, use)] @ x)
    for key in sizes:
        if key in found.least:
            place = 1 + known.keys.index(key)
            return float(shown / np.sqrt(S[place, place]) / found.least[key])
    return None


def load_sizes(load: TiedLoad, machine: Modelled) -> dict[tuple[str, str], float]:
    """Mass, shift of the centre and mean inertia that a load adds to its link."""
    model = mujoco.MjModel.from_xml_path(str(machine.file))
    spec = mujoco.MjSpec.from_file(str(machine.file))
    body = model.body(link(spec, machine, load.target).name)
    mass, lever = float(body.mass[0]), np.array(load.place) - body.ipos
    shift = load.value / (mass + load.value) * lever
    # About every axis, on average, through the common centre.
    inertia = 2.0 / 3.0 * mass * load.value / (mass + load.value) * float(lever @ lever)
    return {
        ("link_mass", load.target): load.value,
        **{("link_com", f"{load.target}_{a}"): float(s) for a, s in zip("xyz", shift, strict=True)},
        ("link_inertia", load.target): inertia,
    }


def _of_fixed(case: LoadCase, plan: Mapping[str, Any]) -> dict[str, Any]:
    """What a machine that is otherwise as declared lacks, and whether another run refutes it."""
    machine, rng = machine_of(case.machine), np.random.default_rng([plan["seed"], case.number])
    pushes = draw_pushes(case.machine, plan["fixed"], rng) if case.kind == "push" else ()
    found = traced_run([run_of(case.machine, case.effects, rng, pushes)], machine, TraceOptions())
    held = run_of(case.machine, case.effects, rng)
    levels = {
        "without": levels_of(held, machine, ()),
        "found": levels_of(held, machine, found.effects),
        "true": true_levels(held, machine, case.effects),
    }
    return _said(found) | {"held_out": levels, "refuted": refuted(found.verdict, levels)}


def refuted(verdict: str, levels: Mapping[str, Mapping[str, float]]) -> list[str]:
    """Channels of a held-out run that refute a verdict."""
    out = []
    for name, true in levels["true"].items():
        found = levels["found"][name]
        left = verdict in CLAIMS and found > LEFT * true
        if left or found > WORSE * max(levels["without"][name], true):
            out.append(name)
    return out


def true_levels(log: Log, machine: Modelled, effects: Sequence[Effect]) -> dict[str, float]:
    """As `levels_of` for the true effects; those that no model compensates are in its file."""
    spec = mujoco.MjSpec.from_file(str(machine.file))
    others = [one for one in effects if type(one).is_compensated()]
    for one in effects:
        if one not in others:
            one.edit_spec(spec, cast(Robot, machine))
    spec.compile()
    with TemporaryDirectory() as folder:
        file = Path(folder) / "machine.xml"
        file.write_text(spec.to_xml())
        return levels_of(log, load_machine(file), others)


def levels_of(log: Log, machine: Modelled, effects: Sequence[Effect]) -> dict[str, float]:
    """RMS residual of each channel of a log with these effects compensated."""
    case = log_under_model(log, machine)
    table, layout = table_of(case, effects), layout_for(machine.limbs)
    return {
        name: float(np.sqrt(np.nanmean(table[:, columns] ** 2)))
        for name, columns in layout.channels.items()
        if np.isfinite(table[:, columns]).any()
    }
