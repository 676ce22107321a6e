"""Robots that others drew, through the README's commands: each ends well and leaves its files."""

import json
from pathlib import Path

import pandas as pd
import pytest
from courses import course_file

from studies.measured import measured_folder
from surefoot.scenarios.cli.main import COMMANDS, main

pytestmark = pytest.mark.long

MODELS = measured_folder().parent / "models"
ROBOTS = {
    "a1": "unitree_a1/a1.xml",
    "go1": "unitree_go1/go1.xml",
    "anymal_b": "anybotics_anymal_b/anymal_b.xml",
    "anymal_c": "anybotics_anymal_c/anymal_c.xml",
}
OF_NO_ROBOT = {"suite", "demo", "new"}
TOO_LONG = {"loop", "tune", "realism"}
"""Made of those that run here, and minutes each."""
COURSE = """turn = 0.05
[ground]
mu = 0.8
[[ground.patch]]
center = [3.0, 0.0]
size = [1.0, 2.0]
mu = 0.3
[ranges]
speed = [0.8, 1.2]
"""
GRID = """
title = "A robot that others drew"
scenarios = ["yard.toml"]
robots = ["{robot}"]
seeds = [7]
filters = ["leg", "imu"]
roles = {{ yard = "test" }}
"""
LEARNT = "--observer mse.safetensors --bounds mse.json --observer gml.safetensors --bounds gml.json"
LINES = f"""
robots {{robot}} -o card.png
view yard.toml --robot {{robot}} -o course.rrd
simulate yard.toml --robot {{robot}} --seeds 0:3 -o walks
info walks/yard_{{name}}_2.parquet
train walks/yard_{{name}}_0.parquet --model mlp --steps 20 -o mse.safetensors
train walks/yard_{{name}}_0.parquet --model mlp --steps 60 --loss gml -o gml.safetensors
calibrate mse.safetensors walks/yard_{{name}}_1.parquet -o mse.json --report judged
calibrate gml.safetensors walks/yard_{{name}}_1.parquet -o gml.json
compare walks/yard_{{name}}_2.parquet {LEARNT} -o compared
estimate walks/yard_{{name}}_2.parquet --filter leg -o leg.parquet
score leg.parquet leg.tum --log walks/yard_{{name}}_2.parquet -o scored
noise walks/yard_{{name}}_2.parquet -o noise.toml
export walks/yard_{{name}}_2.parquet -o walk.mcap
export leg.parquet -o leg.csv
import --guess walk.mcap --robot {{robot}} -o map.toml
import walk.mcap --map map.toml -o back.parquet
align walks/yard_{{name}}_2.parquet -o aligned
view walks/yard_{{name}}_2.parquet -o walk.rrd
plan --robot {{robot}} payload
trace walks/yard_{{name}}_2.parquet -o traced
experiment grid.toml -o grid --no-recordings
"""
LEFT = (
    "card.png course.rrd judged/report.html mse.json compared/report.html compared/table.md"
    " compared/yard_{name}_2.rrd leg.tum noise.toml walk.mcap leg.csv back.parquet walk.rrd"
    " aligned/alignment.png traced/report.html traced/trace.rrd grid/report.html"
)


def test_every_command_of_the_readme_is_here():
    assert {line.split()[0] for line in LINES.split("\n") if line} == (
        COMMANDS.keys() - OF_NO_ROBOT - TOO_LONG
    )


@pytest.mark.parametrize("name", ROBOTS)
def test_a_robot_of_the_menagerie_goes_through_the_readmes_commands(name, tmp_path, monkeypatch):
    if not MODELS.is_dir():
        pytest.skip(f"no models in {MODELS}")
    monkeypatch.chdir(tmp_path)
    robot = MODELS / ROBOTS[name]
    course_file(tmp_path, 39.0, COURSE, "yard")
    Path("grid.toml").write_text(GRID.format(robot=robot))
    for line in LINES.format(robot=robot, name=name).split("\n"):
        main(line.split()) if line else None
    missing = [one for one in LEFT.format(name=name).split() if not Path(one).stat().st_size]
    assert not missing
    rows = pd.read_csv("compared/table.csv").set_index("filter")
    ran = set(rows.index)
    assert {"coverage", "coverage_persistent", "velocity", "leg", "leg_slip", "imu"} <= ran
    assert rows.loc["leg", "APE_trans [m]"] < 0.1, "its legs are as its file says"
    assert json.loads(Path("traced/trace.json").read_text())["verdict"]
