"""The studies of real hardware: without the recordings they skip; with them, what they find."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from pendulum import swung

from studies.hardware import traces
from studies.hardware.go1 import ladder, rolling_table
from studies.hardware.machines import MACHINES, RUNS, Measured
from studies.hardware.report import FINDINGS, WORDS
from studies.hardware.study import MEASURED, HardwareStudy, run_hardware
from surefoot.scenarios.reporting.pages import read_origin, tables_folder
from surefoot.scenarios.reporting.plotting import new_figure
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.toml import read_toml
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.robot import Robot
from surefoot.sim.robot.machine import load_machine
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk

ROOT = Path(__file__).resolve().parents[2]
needs_measured = pytest.mark.skipif(
    not MEASURED.is_dir(), reason=f"the measured logs are not here ({MEASURED})"
)


def test_a_study_without_its_recording_is_skipped_with_a_line(tmp_path, capsys):
    assert run_hardware(HardwareStudy(tmp_path / "out", measured=tmp_path / "nowhere")) == []
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == len(MACHINES)
    assert lines[0].startswith("ak80_pendulum: skipped, its recording is not in")
    assert not (tmp_path / "out").exists()


def test_an_unknown_study_and_files_in_the_way_are_one_line(tmp_path):
    with pytest.raises(SurefootError, match="--only arm: unknown; choose ak80_pendulum"):
        run_hardware(HardwareStudy(tmp_path, only=("arm",)))
    (tmp_path / "measured" / "ak80_pendulum").mkdir(parents=True)
    report = tmp_path / "ak80_pendulum" / "report.html"
    report.parent.mkdir()
    report.write_text("mine")
    with pytest.raises(SurefootError, match=r"report\.html: exists already"):
        run_hardware(
            HardwareStudy(tmp_path, measured=tmp_path / "measured", only=("ak80_pendulum",))
        )
    assert report.read_text() == "mine"


def test_a_finished_study_is_kept_until_its_recording_changes(tmp_path, monkeypatch):
    folder = tmp_path / "measured" / "ak80_pendulum"
    folder.mkdir(parents=True)
    (folder / "run.csv").write_text("1")
    ran = []

    def measured(_) -> Measured:
        ran.append(1)
        held_out = pd.DataFrame([held_out_row("pd", 1.5), held_out_row("ilqr", 0.1)])
        return Measured({"held_out": held_out}, new_figure()[0], "attributed: it explains the log")

    monkeypatch.setitem(MACHINES, "ak80_pendulum", measured)
    out, pages = tmp_path / "out", tmp_path / "results"
    options = HardwareStudy(out, tmp_path / "measured", ("ak80_pendulum",), pages=pages, force=True)
    for _ in range(2):
        assert run_hardware(options) == ["ak80_pendulum"]
    assert len(ran) == 1
    page = pages / "hardware_ak80_pendulum.md"
    assert not read_origin(page).stale
    assert "the torque of 1 of 2 runs" in page.read_text()
    assert "`pd`: 1.500 N m" in page.read_text()
    table = pd.read_csv(tmp_path / "data" / page.stem / "held_out.csv")
    assert list(table["against them"]) == ["much", "much"]
    (out / "cases" / "ak80_pendulum.png").unlink()
    run_hardware(options)
    (folder / "run.csv").write_text("2")
    run_hardware(options)
    assert len(ran) == 3


def held_out_row(run: str, residual: float) -> dict[str, str]:
    return {
        "run held out": run,
        "verdict of the others": "attributed",
        "channel": "joint_torque [N m]",
        "declared model": f"{residual:.3f}",
        "with the others' effects": "0.100",
        "noise floor": "0.200",
        "against them": "much",
    }


def test_every_machine_has_words_and_findings():
    words = read_toml(WORDS, "pages")
    assert list(words) == list(FINDINGS) == list(MACHINES)
    for one in words.values():
        assert {"title", "machine", "method", "caption", "shown", "columns"} == set(one)


@pytest.mark.parametrize("name", MACHINES)
def test_a_page_links_to_every_table_beside_it(name):
    page = ROOT / "docs" / "results" / f"hardware_{name}.md"
    folder = tables_folder(page)
    shown = read_toml(WORDS, "pages")[name]
    files = {path.stem for path in folder.glob("*.csv")}
    assert files == set(re.findall(r"/(\w+)\.csv\)", page.read_text()))
    assert (shown["shown"] in files) == bool(shown["columns"])


def test_a_held_out_run_is_judged_by_what_the_others_show(tmp_path):
    logs = {f"run {k}": swung(friction=0.4, seed=k, seconds=4.0) for k in range(2)}
    found = traces.runs_held_out(logs, load_machine("ak80_pendulum"), tmp_path)
    rows = traces.held_out_table(found).set_index(["run held out", "channel"])
    levels = rows.loc["run 1", "joint_torque [N m]"]
    assert float(levels["with the others' effects"]) < 0.8 * float(levels["declared model"])
    sizes = traces.sizes_table(found)
    friction = sizes[sizes["effect"].str.startswith("coulomb friction shoulder")]
    assert 0.3 < float(friction["run 0"].iloc[0].split(" ")[0]) < 0.5
    channels = {run: said["holdout"]["channels"] for run, said in found.items()}
    bars = traces.levels_figure(channels).axes[0].patches
    assert len(bars) == 2 * sum(map(len, channels.values()))


@pytest.mark.slow
@needs_measured
def test_the_chapter_of_a_real_drive_has_a_row_for_each_run(tmp_path):
    run_hardware(HardwareStudy(tmp_path, only=("ak80_pendulum",)))
    table = pd.read_csv(tmp_path / "ak80_pendulum" / "held_out.csv")
    assert tuple(dict.fromkeys(table["run held out"])) == RUNS
    assert (tmp_path / "cases" / "ak80_pendulum.png").stat().st_size > 10_000


def test_simulated_feet_tell_their_radius_by_any_part_of_the_stance():
    robot = Robot.load("spot_class")
    course = (Segment(6.0, 0.7), Segment(6.0, 0.4, turn=0.5))
    log = walk(Scenario("rolling", course, Ground(0.8)), robot, 2)
    points = replace(robot, foot_radius=np.zeros(4))
    rolling = rolling_table(log, points)["radius by forward velocity [mm]"]
    radii = [float(one.split(" ")[0]) for one in rolling]
    assert radii == pytest.approx([1e3 * robot.foot_radius[0]] * len(radii), rel=0.2)
    assert [words for words, _ in ladder([], points)][1].startswith("not found: foot rolling")
    assert [words for words, _ in ladder([], robot)] == ["as declared"]
