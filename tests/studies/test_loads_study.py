"""The study of loads: what it draws, one case of each half, and how its rules count."""

from collections import Counter
from dataclasses import replace
from typing import cast

import mujoco
import numpy as np
import pytest

from studies.loads import runs
from studies.loads.plan import (
    DELAYS,
    PLAN,
    DenserLink,
    LoadCase,
    TiedLoad,
    draw_load_cases,
    errors_of,
    link,
    machine_of,
)
from studies.loads.report import has_delay, is_above, points_of, right, write_page_of
from studies.loads.runs import draw_pushes, run_of
from studies.loads.trial import load_sizes, refuted, run_load_case
from surefoot import Robot
from surefoot.sim.common.toml import read_toml
from surefoot.sim.effects import effect

PLANNED = read_toml(PLAN, "study")
LOAD = {"name": "tied_load", "target": "elbow", "value": 0.5, "unit": "kg", "place": [0.1, 0, 0]}


def record(verdict="attributed", found=(), rivals=(), kind="load", **more):
    said = [
        {"name": n, "target": t, "value": v, "unit": "", "interval": [0.9 * v, 1.1 * v]}
        for n, t, v in found
    ]
    return {
        "number": 0, "kind": kind, "machine": "arm_of_three", "effects": [LOAD], "cpu": 1.0,
        "verdict": verdict, "effects_found": said, "over_least": 2.0,
        "rivals": [{"name": n, "target": t} for n, t in rivals], **more,
    }  # fmt: skip


def test_draws_cover_what_the_study_asks():
    cases = draw_load_cases(PLANNED)
    kinds = Counter(case.kind for case in cases)
    assert kinds["load"] == 60
    assert kinds["unchanged"] == 30
    assert sum(kinds.values()) - 90 == 40
    loads = Counter(case.machine for case in cases if case.kind == "load")
    assert len(loads) == 4
    assert sum(bool(machine_of(name).limbs.legs) for name in loads) == 2
    fixed = [case for case in cases if case.individual is None]
    assert len({case.machine for case in fixed}) == 3
    assert {e.name for c in fixed for e in c.effects if c.kind == "delay"} == set(DELAYS)
    assert cases == draw_load_cases(PLANNED)


def test_a_load_is_a_point_mass_of_its_link():
    """What a model is told of it has the same mass, centre and mean inertia."""
    machine = machine_of("arm_of_three")
    load = TiedLoad("elbow", 0.5, (0.3, 0.02, -0.01))
    sizes, spec = load_sizes(load, machine), mujoco.MjSpec.from_file(str(machine.file))
    before = spec.compile()
    load.edit_spec(spec, cast(Robot, machine))
    after, body = spec.compile(), link(spec, machine, "elbow").name
    assert after.body_mass.sum() - before.body_mass.sum() == pytest.approx(0.5)
    assert sizes["link_mass", "elbow"] == 0.5
    masses = before.body(body).mass[0], 0.5
    center = np.average([before.body(body).ipos, load.place], axis=0, weights=masses)
    shift = [sizes["link_com", f"elbow_{axis}"] for axis in "xyz"]
    np.testing.assert_allclose(shift, center - before.body(body).ipos)
    # The trace of the inertia about the centre: a third of it about each axis.
    ends = np.array([before.body(body).ipos, load.place]) - center
    assert 3.0 * sizes["link_inertia", "elbow"] == pytest.approx(
        2.0 * np.average((ends**2).sum(axis=1), weights=masses) * sum(masses)
    )


def test_machines_differ_and_their_runs_too():
    machine = machine_of("two_links")
    first, second = (errors_of(machine, np.random.default_rng(seed)) for seed in (0, 1))
    assert first != second
    assert first == errors_of(machine, np.random.default_rng(0))
    late = effect("command_delay", "all", 0.004)
    plain, delayed = (run_of("two_links", e, np.random.default_rng(3)) for e in ((), (late,)))
    rows = slice(1000, -1000)
    # Torques follow their commands two rows later, but for the noise of their sensors.
    apart = delayed.tau[rows] - delayed.columns["tau_ff_lower"][998:-1002, None]
    assert np.abs(apart[:, 1]).std() < 0.1 * delayed.tau[rows, 1].std()
    assert not np.array_equal(plain.tau, delayed.tau)
    pushes = draw_pushes("two_links", PLANNED["fixed"], np.random.default_rng(0))
    pushed = run_of("two_links", (), np.random.default_rng(3), pushes)
    assert np.abs(pushed.tau - plain.tau).max() > 1.0


def test_a_heavier_link_is_found_and_not_refuted():
    case = next(
        c for c in draw_load_cases(PLANNED) if c.kind == "doubled" and c.machine == "two_links"
    )
    assert isinstance(case.effects[0], DenserLink)
    row = run_load_case(replace(case, effects=(DenserLink("lower", 1.0),)))
    assert row["verdict"] == "attributed"
    assert {e["target"] for e in row["effects_found"]} == {"lower"}
    assert row["refuted"] == []
    assert (
        row["held_out"]["found"]["joint_torque"] < 0.2 * row["held_out"]["without"]["joint_torque"]
    )


@pytest.mark.long
def test_a_load_is_traced_against_unchanged_runs(monkeypatch):
    monkeypatch.setattr(runs, "SECONDS", 8.0)
    load = TiedLoad("lower", 0.2, (0.01, 0.02, -0.25))
    row = run_load_case(LoadCase(0, "load", "two_links", 0, (load,)))
    assert points_of(row) == 1.0
    assert row["over_least"] > 1.5


def test_the_right_link_counts():
    named = [("link_mass", "elbow", 0.4), ("link_com", "elbow_x", 0.1)]
    assert points_of(record(found=named)) == 1.0
    assert points_of(record(found=[*named, ("link_mass", "shoulder", 0.1)])) == 0.0
    assert points_of(record(found=[("coulomb_friction", "elbow", 0.4)])) == 0.0
    assert points_of(record("confounded", named, [("link_mass", "shoulder")])) == 0.5
    assert points_of(record("not_identifiable")) == 0.0
    assert not is_above(record(over_least=None))
    assert right(record("unchanged", over_least=0.5)) is None
    assert right(record(found=[("link_mass", "turn", 1.0)], over_least=0.5)) == 0.0
    late = record(found=[("rate_delay", "all", 0.003)], kind="delay", refuted=[])
    late["effects"] = [{"name": "rate_delay", "target": "all", "value": 0.0032, "unit": "s"}]
    assert has_delay(late)
    late["effects"][0]["value"] = 0.004
    assert not has_delay(late)


def test_held_out_runs_refute_what_makes_them_worse_and_what_leaves_too_much():
    levels = {"without": {"joint_torque": 1.0}, "true": {"joint_torque": 0.2}}
    assert refuted("attributed", levels | {"found": {"joint_torque": 0.25}}) == []
    assert refuted("attributed", levels | {"found": {"joint_torque": 0.4}}) == ["joint_torque"]
    assert refuted("none_of_these", levels | {"found": {"joint_torque": 0.4}}) == []
    assert refuted("none_of_these", levels | {"found": {"joint_torque": 1.2}}) == ["joint_torque"]


def test_the_report_counts_what_is_finished(tmp_path):
    named = [("link_mass", "elbow", 0.4)]
    kept = [record(found=named), record("unchanged", kind="unchanged", effects=[])]
    text = write_page_of(tmp_path, kept, tmp_path / "loads.md")
    assert "0 of 1" in text
    assert (tmp_path / "cases.csv").read_text().count("\n") == 3
