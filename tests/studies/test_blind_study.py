"""The blind study: its plan covers what it must, and its rules count as they say."""

import numpy as np
import pytest

from studies.blind import study
from studies.blind.outside_effects import OUTSIDE_EFFECTS
from studies.blind.plan import PLAN, draw_cases
from studies.blind.report import (
    count,
    made_worse,
    names_both_twins,
    points,
    right_channel,
    rules,
    share,
    sized,
    write_report_of,
)
from studies.blind.study import run_blind_study
from studies.blind.trial import ground_and_course, scenario_of, size_over_floor, standing_part
from surefoot.models.attribution.diagnose import Diagnosis
from surefoot.models.attribution.forces import FootFriction
from surefoot.sim.common.toml import read_toml
from surefoot.sim.effects import CATALOGUE, effect
from surefoot.sim.robot import Robot
from surefoot.sim.robot.limbs import QUADRUPED
from surefoot.sim.walk import walk

TRUE = {"name": "encoder_offset", "target": "FL_hip", "value": 0.02, "unit": "rad"}


def record(verdict="attributed", found=(), rivals=(), kind="single", effects=(TRUE,), **more):
    said = [
        {"name": n, "target": t, "value": v, "unit": "rad", "interval": [v - 1e-3, v + 1e-3]}
        for n, t, v in found
    ]
    names = [{"name": n, "target": t, "overlap": 0.99} for n, t in rivals]
    return {
        "number": 0, "kind": kind, "robot": "spot_class", "seed": 0, "effects": list(effects),
        "verdict": verdict, "effects_found": said, "rivals": names, "over_floor": [3.0],
        "channels": {}, **more,
    }  # fmt: skip


def test_the_plan_has_the_whole_catalogue_and_the_kinds_it_must():
    """But for friction of loaded gears, which the study of loads draws, and for given feet."""
    elsewhere = "load_friction", "foot_creep", "foot_scrub"
    catalogue = {name: kind for name, kind in CATALOGUE.items() if name not in elsewhere}
    planned = draw_cases(read_toml(PLAN, "study"))
    single = [c.effects[0].name for c in planned if c.kind == "single"]
    assert len(single) >= 200
    assert {single.count(name) for name in catalogue} == {6}
    outside = [c.effects[0].name for c in planned if c.kind == "outside"]
    assert len(outside) >= 40
    assert min(outside.count(name) for name in OUTSIDE_EFFECTS) == 7
    assert [c.kind for c in planned].count("together") == 40
    assert [c.kind for c in planned].count("clean") == 40
    one = [c.effects[0] for c in planned if c.kind == "single"]
    grouped = [e for e in one if e.target not in type(e).single_targets(QUADRUPED)]
    assert len(grouped) == 2 * sum(bool(k.group_targets(QUADRUPED)) for k in catalogue.values())
    assert all(len(c.effects) == 2 for c in planned if c.kind == "together")
    assert all(not c.effects for c in planned if c.kind == "clean")
    assert min(c.seed for c in planned) > 404
    assert planned == draw_cases(read_toml(PLAN, "study"))


def test_the_pilot_draws_alike_and_shares_nothing_with_the_study():
    study_plan, pilot = (
        read_toml(PLAN.with_name(n), "study") for n in ("study.toml", "pilot.toml")
    )
    for key in ("sizes", "outside_sizes", "twins"):
        assert pilot[key] == study_plan[key]
    for key in ("robots", "seeds"):
        assert not set(pilot["walk"][key]) & set(study_plan["walk"][key])
    assert pilot["seed"] != study_plan["seed"]
    assert {c.kind for c in draw_cases(pilot)} >= {"single", "clean", "outside", "together"}


def test_half_a_point_for_the_truth_among_two():
    right = ("encoder_offset", "FL_hip", 0.0205)
    other = ("hip_offset", "FL_y", 0.01)
    assert points(record(found=[right])) == 1.0
    assert points(record(found=[other])) == 0.0
    assert points(record(found=[("encoder_offset", "FR_hip", 0.02)])) == 0.0
    assert points(record("confounded", [other], [right[:2]])) == 0.5
    assert points(record("confounded", [other], [right[:2], ("gyro_bias", "x")])) == 0.0
    assert points(record("no_residual")) == 0.0
    assert sized(record(found=[right])) is True
    assert sized(record(found=[("encoder_offset", "FL_hip", 0.03)])) is False
    assert sized(record(found=[other])) is None


def test_outside_the_catalogue_the_channel_counts():
    warm = {"name": "thermal_gyro_drift", "target": "x", "value": 0.02, "unit": "rad/s"}
    form = [{"channel": "imu_gyro", "column": "gyro_x", "regressors": ["time"], "share": 0.9}]
    assert right_channel(record("none_of_these", effects=[warm], remainder=form))
    assert not right_channel(record("attributed", effects=[warm], remainder=form))
    levels = {
        "imu_gyro": {"before": 2.0, "noise_floor": 1.0},
        "leg_velocity": {"before": 9.0, "noise_floor": 3.0},
    }
    assert not right_channel(record("none_of_these", effects=[warm], channels=levels))


def test_a_channel_is_worse_where_no_walk_of_its_floor_leaves_as_much():
    def with_level(**level):
        return record(found=[("gyro_bias", "x", 0.1)], channels={"imu_gyro": level})

    worse = with_level(before=1.0, after=1.3, noise_floor=0.9, highest=1.2)
    scatter = with_level(before=1.0, after=1.15, noise_floor=0.9, highest=1.2)
    little = with_level(before=1.0, after=1.05, noise_floor=0.9, highest=1.0)
    without_floor = with_level(before=1.0, after=1.3, noise_floor=None, highest=None)
    assert made_worse([worse, scatter, little, without_floor]) == [True, False, False, True]
    assert made_worse([record("no_residual")]) == []


def test_lost_friction_shows_where_feet_slide():
    """Feet that used a friction of 0.2 of 0.8 without sliding would have hidden three quarters."""
    held = FootFriction(limit=None, interval=(0.2, np.inf), slides=0, everywhere=False, held=0.2)
    found = Diagnosis(verdict="no_residual", channels={}, friction=held)
    assert size_over_floor(found, effect("foot_slip", "all", 0.6)) == pytest.approx(0.8)
    assert size_over_floor(found, effect("foot_slip", "all", 0.9)) == pytest.approx(1.2)


def test_twins_must_both_be_named():
    found, twin = [("encoder_offset", "FL_hip", 0.02)], [("backlash", "FL_hip")]
    assert names_both_twins(record("confounded", found, twin, twin="backlash FL_hip"))
    assert not names_both_twins(record("attributed", found, twin="backlash FL_hip"))


def test_a_robot_whose_twins_cannot_be_told_never_lifts_a_foot():
    log = standing_part(walk(ground_and_course(301, True), Robot.load("spot_class"), 301))
    assert log.contact.all()
    assert log.t[-1] - log.t[0] > 15.0


def test_the_report_is_written_from_what_was_run(tmp_path):
    right = [("encoder_offset", "FL_hip", 0.02)]
    records = [
        record(found=right),
        record("no_residual", kind="clean", effects=(), over_floor=[]),
        record(found=right, kind="together", effects=(TRUE,)),
        record("no_residual"),
    ]
    text = write_report_of(tmp_path, records)
    assert "| right effect and target first" in text
    headings = [line for line in text.splitlines() if line.startswith("## ")]
    assert headings[0] == "## Findings"
    assert {"## Every miss", "## Two effects at once", "## Every case"} < {*headings}
    assert "## False names on clean logs" not in headings
    assert len((tmp_path / "every_miss.csv").read_text().splitlines()) == 2
    assert (tmp_path / "report.html").stat().st_size > 10_000
    measured = {row["rule"]: row["measured"] for row in rules(records)}
    assert measured["a false name on a clean log"].startswith("0 of ")


def test_a_study_that_was_stopped_goes_on_where_it_was(tmp_path, monkeypatch):
    monkeypatch.setattr(study, "run_case", lambda case, plan: {"number": case.number})
    assert run_blind_study(tmp_path, at_most=3) == [{"number": 0}, {"number": 1}, {"number": 2}]
    monkeypatch.setattr(study, "run_case", lambda case, plan: {"number": -case.number})
    assert run_blind_study(tmp_path, at_most=1)[1:] == [
        {"number": 1},
        {"number": 2},
        {"number": -3},
    ]


def test_one_case_in_many_is_not_none():
    assert count([]) == "no case"
    assert count([False] * 20).startswith("0 of 20 (0.0..")
    assert count([False] * 291 + [True]) == "1 of 292 (0.1..1.9 %)"


def test_nearly_all_is_not_all():
    assert share([True] * 212 + [False]).startswith("99.5 % (")
    assert share([True] * 213).startswith("100 % (")
    assert share([True] * 91 + [False] * 9).startswith("91 % (")


def test_beyond_the_study_lie_other_grounds_late_joints_and_larger_effects():
    plan_file = PLAN.with_name("beyond.toml")
    plan, sizes = read_toml(plan_file, "study"), read_toml(PLAN, "study")["sizes"]
    planned = draw_cases(plan)
    of = {kind: [c for c in planned if c.kind == kind] for kind in ("exact", "late", "large")}
    assert sum(map(len, of.values())) == len(planned) == 40
    assert not any(c.effects for c in of["exact"])
    grounds = [scenario_of(c, plan_file).ground for c in of["exact"][:4]]
    assert [bool(g.patches) for g in grounds] == [False, True, False, False]
    assert [max((s.steps for s in g.strips), default=0) > 0 for g in grounds] == [0, 0, 1, 0]
    assert grounds[3].strips[0].rough == 4.0 * plan["rough"]
    assert {c.effects[0].value for c in of["late"]} == set(plan["lateness"])
    for (one,) in (c.effects for c in of["large"]):
        assert abs(one.value) == pytest.approx(2.0 * sizes[one.name][1])


def test_the_page_of_what_lies_beyond_says_what_fell(tmp_path):
    more = {"ground": "stairs", "reasons": [], "masked_share": 0.0}
    rows = [record(kind="exact", effects=(), **more), record("none_of_these", kind="late", **more)]
    rows.append({"number": 2, "kind": "large", "fell": "it fell", "effects": [TRUE]})
    rows[2] |= {"robot": "spot_class", "seed": 0}
    said = write_report_of(tmp_path / "out", rows, plan=PLAN.with_name("beyond.toml"))
    assert "no log: 1." in said
    assert "0 % (0..79) of 1" in said
