"""What the page of a trace says, in which order, and that its next commands are commands."""

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from surefoot.models.attribution.data import LACKING
from surefoot.models.attribution.effect_sizes import Found
from surefoot.models.attribution.explain import Candidate
from surefoot.models.attribution.judgement import ChannelLevel
from surefoot.scenarios.cli.main import _parsed
from surefoot.scenarios.reporting.tables import as_frame
from surefoot.scenarios.settings import TraceSettings
from surefoot.scenarios.trace.filters import (
    DEAD_RECKONING,
    REPORTED,
    DriftCauses,
    change_of_errors,
)
from surefoot.scenarios.trace.next_steps import next_steps
from surefoot.scenarios.trace.report import (
    VERDICTS,
    _sizes,
    ranked_notes,
    sections,
    state_of,
    summary,
)
from surefoot.scenarios.trace.result import Trace
from surefoot.sim.common import plugins
from surefoot.sim.effects import effect

LONG = effect("link_length", "FR_calf", 0.006)
ONE = Found(LONG, (0.005, 0.007))
RIVAL = {"name": "encoder_offset", "target": "FR_calf", "overlap": 0.97}
FLOOR = {"noise_floor": 0.1, "unit": "m/s", "of_noise": 0.15}
CHANNELS = {
    "leg_velocity": ChannelLevel(0.5, 0.4, **FLOOR),
    "stance_displacement": ChannelLevel(0.9, 0.888, **FLOOR, evaluation_only=True),
    "imu_gyro": ChannelLevel(0.1, 0.1, **FLOOR),
}
FILES = TraceSettings(logs=(Path("a b.parquet"), Path("c.parquet")), out=Path("out/traced"))
DECLARED = TraceSettings(
    logs=(Path("a.parquet"),),
    out=Path("traced"),
    robot="go2",
    declared=Path("old.toml"),
    holdout=(Path("unseen.parquet"),),
)


def side(error):
    return dict.fromkeys(REPORTED, error)


FILTERS = {
    "leg": {"before": side(0.2), "after": side(0.1)},
    "imu": {"before": side(1.0), "after": side(1.2)},
}


def result(verdict, **known):
    effects = () if verdict in ("no_residual", "unchanged") else (ONE,)
    rivals = (RIVAL,) if verdict == "confounded" else ()
    given = {"channels": CHANNELS, "filters": FILTERS, "found": effects, "rivals": rivals} | known
    return Trace(verdict=verdict, **given)


def test_an_effect_is_named_from_a_size_of_its_own():
    (row,) = _sizes(result("attributed"), [replace(ONE, excess=8.7, least=0.004, agreement=9.0)])
    assert (row["named from"], row["standard deviations"]) == ("0.004", "8.7")


def table_of(found, heading):
    (one,) = [section for section in sections(found) if section.heading == heading]
    return as_frame(one.table or [])


def test_dead_reckoning_has_no_attitude_of_its_own_to_judge():
    same = {"before": side(0.1), "after": side(0.1)}
    filters: dict[str, Any] = {"leg": same, DEAD_RECKONING: same}
    found = Trace(verdict="no_residual", channels={}, filters=filters)
    leg, reckoned = table_of(found, "Every metric of the filters").to_dict("records")
    assert not any(pd.isna(value) for value in leg.values())
    shown = {name for name, value in reckoned.items() if not pd.isna(value)}
    assert shown == {
        *("filter", "APE_trans [m]", "RPE_trans [m]", "drift [m/m]", "velocity [m/s]", "")
    }


@pytest.mark.parametrize("files", [FILES, DECLARED], ids=["plain", "declared"])
@pytest.mark.parametrize("verdict", VERDICTS)
def test_each_verdict_says_what_to_do_next_in_commands_that_are_commands(verdict, files, robot):
    found = result(verdict)
    steps = next_steps(found, files, robot)
    commands = [step.command for step in steps if step.command]
    assert commands
    written = set()
    for command in commands:
        program, *arguments = shlex.split(command)
        if program == "surefoot":
            name, parsed = _parsed(arguments)
            assert name == arguments[0]
            written.add(str(getattr(parsed, "out", None)))
        else:  # two files of effects become one
            assert command == "cat old.toml traced/effects.toml > traced_model.toml"
    assert str(files.out) not in written  # what the trace wrote is not replaced
    # The effects are used from the file that has all of them, after it has been written.
    uses = [c for c in commands if "--effects" in c]
    assert all("traced/effects.toml" in c or files.declared for c in uses)
    assert all("traced_model.toml" in c for c in uses if files.declared)
    assert bool(uses) == (verdict in ("attributed", "confounded", "none_of_these"))
    asks = any("--holdout" in command for command in commands)
    assert asks == (verdict == "attributed" and not files.holdout)
    # What changed since unchanged runs is sought in each run by itself.
    since = next_steps(replace(found, least={("link_mass", "FL_calf"): 0.1}), files, robot)
    assert not any("--holdout" in (step.command or "") for step in since)


def test_commands_name_the_files_of_plugins(robot, monkeypatch):
    monkeypatch.setattr(plugins, "_LOADED", {"/at/my own.py": "my own.py"})
    commands = [step.command for step in next_steps(result("attributed"), FILES, robot)]
    assert all(command.endswith(" --plugin 'my own.py'") for command in commands)


@pytest.mark.parametrize("channels", [["imu_gyro"], ["imu_gyro", "leg_velocity"]])
def test_contacts_are_checked_where_the_log_has_legs(channels, robot):
    found = result("none_of_these", channels={name: CHANNELS[name] for name in channels})
    first, *_ = next_steps(found, FILES, robot)
    assert ("contacts" in first.words, "--contacts" in first.command) == (len(channels) > 1,) * 2


def test_where_nothing_is_found_the_sizes_that_would_have_been_are_said(robot, monkeypatch):
    """Of an effect's parts, that which is seen worst."""
    least = {"FL_thigh": 0.12, "FR_thigh": 0.05}
    seen = [
        Candidate(("encoder_offset", part), 0.0, 0.0, 0.0, size, at_bound=False, earned=False)
        for part, size in least.items()
    ]
    monkeypatch.setattr(Trace, "rounds", (tuple(seen),))
    words = [step.words for step in next_steps(result("no_residual"), FILES, robot)]
    assert "Record more to find encoder_offset below 0.12 rad" in words


def test_least_changes_that_no_machine_could_have_are_not_listed():
    least = {("encoder_offset", "FL_thigh"): 0.01, ("link_com", "FL_calf_x"): 62.0}
    found = replace(result("unchanged"), least=least)
    (one,) = (x for x in sections(found) if x.heading.startswith("Least changes"))
    assert pd.DataFrame(one.table)["effect"].tolist() == ["encoder_offset"]
    assert "link_com" in one.prose
    assert "encoder_offset" not in one.prose


def test_a_channel_for_evaluation_is_not_said_to_be_at_its_floor():
    states = {name: state_of(level) for name, level in CHANNELS.items()}
    assert states["leg_velocity"] == "above its floor"
    assert states["imu_gyro"] == "at its floor"
    assert states["stance_displacement"] not in (states["imu_gyro"], states["leg_velocity"])
    shown = table_of(result("none_of_these"), "Residual of each channel")
    assert dict(zip(shown["channel"], shown[""], strict=True)) == states
    said = next(x for x in summary(result("none_of_these")).splitlines() if "displacement" in x)
    assert states["stance_displacement"] in said
    assert states["imu_gyro"] not in said


def test_notes_on_faults_come_first_and_the_others_are_folded():
    notes = (
        "accel_x: clipped",
        "the ground is assumed even to 1.3 mm (standard deviation)",
        f"joint_torque{LACKING}tau",
        "leg_velocity: 4 times its residual in simulation is left, which may distort the sizes",
        "imu filter: larger error with the effects found",
    )
    found = result("none_of_these", notes=notes, warnings=notes[:1], worse=notes[4:])
    first, further = ranked_notes(found)
    assert first == [notes[0], notes[3], notes[4]]
    assert {notes[1], notes[2]} <= set(further)
    said = summary(found)
    assert all(said.count(note[1:]) == (note in first) for note in notes)
    folded = {one.heading for one in sections(found) if one.folded}
    assert "What is assumed, and what these logs cannot show" in folded
    assert "Notes" not in folded


def test_causes_of_the_drift_are_in_units_of_each():
    causes = DriftCauses(np.full(4, 0.02), ((LONG, np.full(4, 0.015)),), np.full(4, 0.005))
    found = result("attributed", causes=causes)
    rows = table_of(found, "Causes of the drift")
    assert list(rows["height [mm/m]"].astype(float)) == [20.0, 15.0, 5.0]
    assert list(rows["yaw [deg/m]"].astype(float)) == pytest.approx([1.15, 0.86, 0.29])
    assert list(rows["distance [%]"].astype(float)) == [2.0, 1.5, 0.5]


@pytest.mark.parametrize(
    ("ape", "rpe", "change"),
    [(2.0, 2.0, "worse"), (0.5, 1.0, "better"), (2.0, 0.5, "mixed"), (1.04, 0.96, "same")],
)
def test_a_filter_changes_by_all_its_errors_of_position(ape, rpe, change):
    before = {"ape_trans": 1.0, "rpe_trans": 1.0, "drift": 1.0, "velocity": 0.0}
    after = before | {"ape_trans": ape, "rpe_trans": rpe}
    assert change_of_errors({"before": before, "after": after}) == change
