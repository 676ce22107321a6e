"""A small experiment from its file to its folder: killed, gone on with, and changed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from courses import course_file
from scipy.spatial.transform import Rotation

from surefoot import FilterSettings, Scenario, walk
from surefoot.scenarios.experiments.file import Experiment, cells_of
from surefoot.scenarios.experiments.products import drawn_start
from surefoot.scenarios.experiments.report import experiment, falls
from surefoot.scenarios.experiments.run import CellResult, Outcome
from surefoot.scenarios.experiments.tables import (
    averages,
    published,
    shown_first,
)
from surefoot.scenarios.settings import GridSettings
from surefoot.scenarios.training import drawn_course, many_walks
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.scenario import Segment

# pyright: reportArgumentType=false, reportGeneralTypeIssues=false

MORE = "turn = 0.2\n[ranges]\nspeed = [0.9, 1.1]\n"
GRID = """
title = "A small grid"
scenarios = ["learn.toml", "hold.toml", "try.toml"]
filters = ["coverage", "leg", "imu"]
gammas = [0.8]
[sweep]
gammas = [0.6]
[observer]
losses = ["mse"]
inputs = "q,dq"
steps = 4
[[condition]]
name = "as drawn"
[[condition]]
name = "as built"
imperfections = "built.toml"
sensors = {contact_delay = 0.004}
"""
BUILT = """
[[imperfection]]
effect = "encoder_offset"
normal = 0.01
source = "a test"
"""


@pytest.fixture(scope="module")
def grid(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("grid")
    course_file(folder, 11, MORE, "learn", "train")
    course_file(folder, 22, MORE, "hold", "calibrate", 0.6)
    course_file(folder, 4, MORE, "try")
    (folder / "grid.toml").write_text(GRID)
    (folder / "built.toml").write_text(BUILT)
    return folder


def made(grid: Path) -> dict[str, dict[str, int]]:
    """Files of the cache by kind, with the time of their making."""
    return {
        kind.name: {p.name: p.stat().st_mtime_ns for p in kind.glob("*") if p.suffix != ".json"}
        for kind in (grid / "out" / "cache").iterdir()
    }


@pytest.fixture(scope="module")
def rows(grid) -> pd.DataFrame:
    return experiment(grid / "grid.toml", GridSettings(grid / "out"))


def test_the_grid_is_one_tidy_table(grid, rows):
    read = pd.read_parquet(grid / "out" / "results.parquet")
    pd.testing.assert_frame_equal(read, rows)
    # Three walks under two conditions; coverage at two gammas, the others at none.
    assert len(rows) == 3 * 2 * (2 + 1 + 1)
    cells = rows[["sequence", "condition", "filter", "gamma"]]
    assert not cells.duplicated().any()
    assert set(rows["role"]) == {"train", "calibrate", "test"}
    assert rows["APE_trans [m]"].notna().all()
    assert rows.loc[rows["filter"] == "coverage", "coverage [%]"].between(0, 100).all()
    wider = rows[rows["filter"] == "coverage"].pivot_table(
        index=["sequence", "condition"], columns="gamma", values="coverage [%]"
    )
    assert (wider[0.8] >= wider[0.6]).all()


def test_what_a_robot_is_built_like_costs_the_filter_that_trusts_its_drawing(rows):
    leg = rows[rows["filter"] == "leg"].groupby("condition")["APE_trans [m]"].mean()
    assert leg["as built"] > 1.5 * leg["as drawn"]


def test_the_folder_holds_tables_report_figures_and_recordings(grid, rows):
    out = grid / "out"
    files = {"results.csv", "averages.csv", "sequences_as_built.csv", "table.md"}
    assert files <= {p.name for p in out.iterdir()}
    assert list(pd.read_csv(out / "sweep.csv")["gamma"]) == [0.6, 0.8, 0.6, 0.8]
    page = (out / "report.html").read_text()
    assert page.index("Findings") < page.index("Setting") < page.index("Averages")
    assert "<strong>try</strong>" in page
    assert page.count("<img") == len(list((out / "figures").glob("*.png")))
    assert {p.stem for p in (out / "recordings").glob("*.rrd")} == {
        f"{walk}_as_{how}" for walk in ("learn", "hold", "try") for how in ("drawn", "built")
    }


@pytest.mark.long
def test_a_changed_scenario_makes_only_what_it_decides(grid, rows):
    before = made(grid)
    course_file(grid, 5, MORE, "try")
    how = GridSettings(grid / "out", force=True, no_recordings=True)
    again = experiment(grid / "grid.toml", how)
    added = {kind: set(files) - set(before[kind]) for kind, files in made(grid).items()}
    counts = {kind: len(names) for kind, names in added.items() if names}
    assert counts == {"walk": 2, "estimate": 2 * 4}
    for kind, files in before.items():
        assert files.items() <= made(grid)[kind].items()
    same = again["sequence"] != "try"
    pd.testing.assert_frame_equal(again[same], rows[same])


@pytest.mark.long
def test_finished_rows_need_no_products(grid, rows, tmp_path, capsys):
    data, cache = tmp_path / "rows", tmp_path / "cache"
    course_file(grid, 4, MORE, "try")
    how = GridSettings(tmp_path / "a", cache=grid / "out/cache", no_recordings=True, data=data)
    first = experiment(grid / "grid.toml", how)
    pd.testing.assert_frame_equal(first, rows)
    assert len(list(data.glob("*.json"))) == 3 * 2
    again = experiment(grid / "grid.toml", replace(how, out=tmp_path / "b", cache=cache))
    pd.testing.assert_frame_equal(again, first)
    assert not list(cache.glob("*/*"))


@pytest.mark.long
def test_other_ways_to_learn_are_tables_beside(grid, rows, tmp_path, monkeypatch):
    monkeypatch.setattr(many_walks, "SECONDS", 20.0)
    monkeypatch.setattr(many_walks, "HELD_OUT", (1, 0.0))
    ways = (
        'inputs = "q,dq"\nmethod = "maxnorm"',
        'inputs = "q,dq,tau"\nmethod = "maxnorm"',
        'inputs = "q,dq"\nwalks = 2\ncalibration_walks = 2',
    )
    further = "".join(f'[[further]]\nlosses = ["mse"]\nsteps = 4\n{one}\n' for one in ways)
    (grid / "further.toml").write_text(GRID.replace("[observer]", f"{further}[observer]"))
    out, cache = tmp_path / "out", grid / "out" / "cache"
    before = made(grid)
    more = experiment(grid / "further.toml", GridSettings(out, cache=cache, no_recordings=True))
    added = {kind: len(files.keys() - before[kind].keys()) for kind, files in made(grid).items()}
    ways = more[more["filter"] == "coverage"].groupby(["walks", "inputs", "method"])["gamma"]
    found = ways.agg(set)
    # Twenty seconds are too few for some method with some inputs: it is left out there.
    assert found[0, "q,dq", "conformal"] == {0.6, 0.8}
    assert found[0, "q,dq", "maxnorm"] == found[0, "q,dq,tau", "maxnorm"] == {0.8}
    assert found[2, "q,dq", "conformal"] == {0.8}
    # The drawn walks are of both conditions alike: one observer, with one pair of bounds.
    assert (added["walk"], added["observer"]) == (2 + 2 + 1, 2 + 1)
    first = shown_first(more, Experiment.load(grid / "further.toml"))
    same = shown_first(rows, Experiment.load(grid / "grid.toml"))
    assert len(first) == len(same)
    assert "How observers and bounds are learnt" in (out / "table.md").read_text()


@pytest.mark.parametrize(
    ("name", "learnt"),
    [
        ("spot", {"Upstair": "train", "Quad": "calibrate"}),
        ("vision60", {"3CC3CCW": "train", "RoomScan": "calibrate"}),
    ],
)
def test_the_suites_are_two_such_files(name, learnt):
    suite = Experiment.load(name)
    roles = {s.name: s.role for s in suite.scenarios}
    assert {n: role for n, role in roles.items() if role != "test"} == learnt
    assert len(suite.seeds) >= 3
    assert len(set(cells_of(suite))) == len(roles) * len(suite.seeds) * len(suite.conditions)
    assert set(published(name)[0]["sequence"]) == set(roles)


def test_a_shift_is_learnt_from_another_condition():
    suite = replace(Experiment.load("spot"), seeds=(0,))
    shifted = [cell for cell in cells_of(suite) if cell.condition.name == "shifted"]
    assert {cell.group for cell in shifted} == {("spot_class", "as built", 0)}
    assert not any(cell.learnt_from for cell in shifted)
    scenario, built = shifted[0].walk.scenario, shifted[0].scenario
    assert scenario.gait.duty == 0.75 != built.gait.duty
    assert scenario.ranges.payload[0] > drawn_course.RANGES.payload[1]
    assert scenario.ranges.clearance == built.ranges.clearance  # what is not given stays


def test_the_papers_averages_are_given_as_printed_and_from_its_rows():
    both = published("spot")[1]
    ours = both[both["method"] == "Ours"].set_index("average")["APE_trans [m]"]
    assert ours["as printed"] == 2.736
    assert ours["from its rows"] == pytest.approx(3.043, abs=5e-4)


def test_averages_are_over_test_sequences_and_spread_is_over_seeds(rows):
    grown = pd.concat([rows, rows.assign(seed=1, **{"APE_trans [m]": rows["APE_trans [m]"] + 1})])
    leg = averages(grown[grown["filter"] == "leg"]).set_index("condition")
    test = rows[(rows["role"] == "test") & (rows["filter"] == "leg")].set_index("condition")
    for condition, value in test["APE_trans [m]"].items():
        text = leg.loc[condition, "APE_trans [m]"]
        assert text == f"{value + 0.5:.3f} ± {np.sqrt(0.5):.3f}"


def test_what_a_fall_leaves_out_is_said():
    suite = replace(Experiment.load("spot"), seeds=(4,))

    def result(cell):
        fell = cell.condition.name == "as walked" and cell.scenario.role == "calibrate"
        lacking = {"coverage": "needs --bounds"} if cell.condition.name == "as walked" else {}
        return CellResult({"falls": int(fell)}, (), lacking | {"radar_leg": "no radar"})

    cells = {cell: result(cell) for cell in cells_of(suite)}
    outcome = Outcome(cells, Path(), {})
    assert falls(outcome, "as walked").startswith("The robot fell")
    assert "Quad, to calibrate with (seed 4)" in falls(outcome, "as walked")
    assert falls(outcome, "as drawn") == ""
    assert outcome.left_out == {"coverage": "needs --bounds", "radar_leg": "no radar"}


def test_starts_are_off_by_what_the_filters_declare(robot):
    log = walk(Scenario("start", (Segment(0.5, 0.0),), Ground(0.8)), robot, 0)
    state, covariance = FilterSettings().beginning(log, robot.feet)
    std = np.sqrt(covariance.diagonal())
    rng, off = np.random.default_rng(0), []
    for _ in range(300):
        start, same = drawn_start(log, robot, rng).beginning(log, robot.feet)
        assert np.sqrt(same.diagonal()) == pytest.approx(std, rel=0.05)
        assert np.array_equal(start.b_g, state.b_g)
        turned = Rotation.from_matrix(start.R_GI @ state.R_GI.T).as_rotvec()
        off.append([*turned, *(start.v_GI - state.v_GI), *(start.b_a - state.b_a)])
    wanted = std[[0, 1, 2, 3, 4, 5, 9, 10, 11]]
    assert np.std(off, axis=0) == pytest.approx(wanted, rel=0.2)
