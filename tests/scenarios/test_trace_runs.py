"""Traces of several runs of a machine, and of logs too long to be traced whole."""

import json
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from pendulum import swung
from refusals import refused
from synthetic import without

from surefoot.scenarios.cli.main import main
from surefoot.scenarios.settings import TraceSettings
from surefoot.scenarios.trace import long_logs
from surefoot.scenarios.trace.long_logs import (
    in_blocks,
    read_in_blocks,
)
from surefoot.scenarios.trace.run import (
    TraceOptions,
    trace,
    trace_files,
    trace_logs,
    unchanged_beside,
)
from surefoot.sim.effects import effect
from surefoot.sim.effects.base import with_columns
from surefoot.sim.effects.file import load_effects, save_effects
from surefoot.sim.robot.machine import load_machine

PENDULUM = load_machine("ak80_pendulum")


ROTOR = effect("armature", "shoulder", 0.03)


@lru_cache
def run(seed, zero=0.0, **hidden):
    """The pendulum of a seed, whose encoder reads `zero` [rad] too much."""
    log = swung(seed=seed, seconds=8.0, **hidden)
    column = log.frame["q_shoulder"].to_numpy() + zero
    return replace(with_columns(log, {"q_shoulder": column}), name=f"run_{seed}")


def test_a_torque_scale_and_dry_friction_of_one_drive_have_their_sizes():
    """Larger scales and smaller masses would make the whole equation smaller, and what is left."""
    found = trace_logs([swung(scale=1.2, friction=0.15)], PENDULUM)
    assert [e.name for e in found.effects] == ["torque_scale", "coulomb_friction"]
    assert [e.value for e in found.effects] == pytest.approx([0.2, 0.15], rel=0.05)
    assert found.verdict == "attributed"


def names(found):
    return [(e.name, e.target) for e in found.effects]


def zeros(found):
    return [{one.effect.name: one.effect.value for one in run.zeros} for run in found.runs]


@pytest.fixture(scope="module")
def of_two_runs():
    logs = [run(0, 0.12, armature=0.03), run(1, -0.09, armature=0.03)]
    return trace_logs(logs, PENDULUM, TraceOptions(holdout=[run(2, 0.06, armature=0.03)]))


def test_two_runs_share_sizes_and_have_zeros_of_their_own(of_two_runs):
    assert names(of_two_runs) == [("armature", "shoulder")]
    # Noise of the rates, by which it multiplies, makes it a tenth too small.
    assert of_two_runs.effects[0].value == pytest.approx(0.03, rel=0.15)
    first, second = (one["encoder_offset"] for one in zeros(of_two_runs))
    assert (first, second) == (pytest.approx(0.12, abs=0.02), pytest.approx(-0.09, abs=0.02))
    runs = of_two_runs.as_dict()["runs"]
    assert [[one["name"] for one in run] for run in runs] == [["encoder_offset"]] * 2


def test_a_held_out_run_agrees_and_has_a_zero_of_its_own(of_two_runs):
    held_out = of_two_runs.held_out
    torque = held_out.channels["joint_torque"]
    assert torque.after < 0.75 * torque.before
    (zero,) = held_out.runs[0].zeros
    assert zero.effect.value == pytest.approx(0.06, abs=0.02)


def test_an_effect_that_makes_a_held_out_run_worse_is_dropped():
    found = trace_logs([run(0, armature=0.03)], PENDULUM, TraceOptions(holdout=[run(2)]))
    assert names(found) == []
    assert found.verdict != "attributed"
    dropped = {(one.name, one.target): why for one, why in found.rejected}
    assert "held-out run 1" in dropped["armature", "shoulder"]


@pytest.mark.long
def test_a_held_out_run_is_not_evaluated_where_its_joint_sticks():
    """At rest the drive pushes with any torque that dry friction holds."""
    moves = run(1, friction=0.4)
    rests = moves.frame.copy()
    rests["t"] -= rests.t.iloc[-1] + 1.0 / moves.rate
    noise = np.random.default_rng(0).normal(size=(2, len(rests)))
    rests["q_shoulder"], rests["dq_shoulder"] = moves.frame.q_shoulder.iloc[0], 0.02 * noise[0]
    rests["tau_shoulder"] = 0.35 + 0.2 * noise[1]
    stuck = replace(moves, frame=pd.concat([rests, moves.frame], ignore_index=True))
    levels = []
    for log in (moves, stuck):
        found = trace_logs([run(0, friction=0.4)], PENDULUM, TraceOptions(holdout=[log]))
        assert names(found) == [("coulomb_friction", "shoulder")]
        assert found.held_out is not None
        levels.append(found.held_out.channels["joint_torque"].after)
    assert levels[1] == pytest.approx(levels[0], rel=0.1)


def test_nothing_has_changed_but_a_zero():
    found = trace_logs([run(3, 0.1, armature=0.03)], PENDULUM, TraceOptions(declared=[ROTOR]))
    assert (found.verdict, found.effects) == ("no_residual", ())
    assert zeros(found)[0]["encoder_offset"] == pytest.approx(0.1, abs=0.02)


def test_what_has_changed_is_named_and_what_was_declared_is_not():
    changed = run(3, armature=0.03, friction=0.3)
    found = trace_logs([changed], PENDULUM, TraceOptions(declared=[ROTOR]))
    assert names(found)[0] == ("coulomb_friction", "shoulder")
    assert "armature" not in [e.name for e in found.effects]


@pytest.mark.long
def test_less_friction_than_was_declared_is_named_and_less_than_none_is_not():
    had, has = 0.5, 0.3
    declared = [effect("coulomb_friction", "shoulder", had)]
    found = trace_logs([run(3, friction=has)], PENDULUM, TraceOptions(declared=declared))
    assert names(found) == [("coulomb_friction", "shoulder")]
    assert found.effects[0].value == pytest.approx(has - had, rel=0.1)
    assert found.verdict == "attributed"
    # Together they are what the drive has.
    known = TraceOptions(declared=[*declared, *found.effects])
    both = trace_logs([run(4, friction=has)], PENDULUM, known)
    assert (both.verdict, names(both)) == ("no_residual", [])
    # Without a declaration there is nothing to lose.
    scaled = trace_logs([run(3, scale=0.9)], PENDULUM)
    assert all(e.value > 0.0 for e in scaled.effects if e.name == "coulomb_friction")


def test_the_command_takes_declared_effects_and_held_out_logs(tmp_path, capsys):
    for number, log in enumerate((run(0, armature=0.03), run(1, armature=0.03)), 1):
        log.write(tmp_path / f"{number}.parquet")
    save_effects(tmp_path / "effects.toml", [ROTOR])
    first, second = (str(tmp_path / f"{n}.parquet") for n in (1, 2))
    common = ["trace", first, "--declared", str(tmp_path / "effects.toml"), "-o"]
    main([*common, str(tmp_path / "out"), "--holdout", second])
    assert "no_residual" in capsys.readouterr().out
    said = json.loads((tmp_path / "out" / "trace.json").read_text())
    assert said["holdout"]["channels"]["joint_torque"]["noise_floor"] > 0
    assert "held-out logs" in (tmp_path / "out" / "report.html").read_text()
    replace(run(1), meta=replace(run(1).meta, robot="spot_class")).write(tmp_path / "other.parquet")
    for name, said in (("1", "is also a log to fit on"), ("other", "trace one robot at a time")):
        line = [*common, f"{tmp_path}/same", "--holdout", f"{tmp_path}/{name}.parquet"]
        refused(said, main, line, error=SystemExit)


def test_runs_without_torques_are_traced():
    """One candidate alone is left: a delay of the rates."""
    found = trace_logs([without(run(seed), "tau_") for seed in range(3)], PENDULUM)
    assert (found.verdict, found.model_error) == ("no_residual", None)


def test_a_log_is_given_once(tmp_path):
    logs = [run(0), run(1), run(0)]
    refused("run_0: the same log is given twice", trace, logs, PENDULUM, tmp_path)


@pytest.mark.long
def test_what_has_changed_stands_out_from_what_unchanged_runs_differ_by(tmp_path, capsys):
    """A rotor seems another in each run: one more such run is no change, friction is one."""
    logs = [run(k, armature=x) for k, x in ((0, 0.01), (1, 0.03), (2, 0.05), (5, 0.02))]
    out = tmp_path / "calibrated"
    before = trace(logs, PENDULUM, out, TraceOptions(declared=[]))
    assert before.model_error is not None
    declared = load_effects(out / "effects.toml")
    since = unchanged_beside(out / "effects.toml", declared)
    assert since is not None
    assert since.keys == before.model_error.keys
    assert np.array_equal(since.covariance, before.model_error.covariance)
    one_more = run(3, armature=0.05)
    again = trace_logs([one_more], PENDULUM, TraceOptions(declared=declared, since=since))
    assert (again.verdict, names(again)) == ("unchanged", [])
    assert again.least["coulomb_friction", "shoulder"] < 1.2
    one_more.write(tmp_path / "new.parquet")
    main(["trace", str(tmp_path / "new.parquet"), "--declared", str(out / "effects.toml"), "-o",
          str(tmp_path / "new")])  # fmt: skip
    said = capsys.readouterr().out
    assert "verdict: unchanged" in said
    page = (tmp_path / "new" / "report.html").read_text()
    assert "4 runs of the unchanged machine" in page
    assert "coulomb_friction" in said
    new = (tmp_path / "new.parquet",)
    also = TraceSettings(
        logs=new, out=tmp_path / "other", declared=out / "effects.toml", holdout=new
    )
    refused("--holdout: runs are compared with those of", trace_files, also)
    rubs = run(4, armature=0.03, friction=0.5)
    changed = trace_logs([rubs], PENDULUM, TraceOptions(declared=declared, since=since))
    assert (changed.verdict, names(changed)) == ("attributed", [("coulomb_friction", "shoulder")])
    assert changed.effects[0].value == pytest.approx(0.5, rel=0.25)


@pytest.mark.long
def test_a_bias_of_all_runs_is_no_change_and_nor_is_the_order_of_effects(tmp_path):
    """A torque sensor's zero, which each run has at about one size, and a drive's effects."""

    def biased(seed):
        log = run(seed, armature=0.03, friction=0.5)
        return with_columns(log, {"tau_shoulder": log.tau[:, 0] + 0.8})

    trace([biased(seed) for seed in range(4)], PENDULUM, tmp_path, force=True)
    file = tmp_path / "effects.toml"
    declared = load_effects(file)
    since = unchanged_beside(file, declared)
    assert since is not None
    assert unchanged_beside(file, declared[::-1]) is not None
    again = trace_logs([biased(7)], PENDULUM, TraceOptions(declared=declared, since=since))
    assert (again.verdict, names(again)) == ("unchanged", [])


def test_another_traces_runs_say_nothing_and_damaged_ones_are_one_line(tmp_path):
    save_effects(tmp_path / "effects.toml", [ROTOR])
    file = tmp_path / "trace.json"
    assert unchanged_beside(tmp_path / "effects.toml", [ROTOR]) is None
    said = {"effects": [{**ROTOR.as_dict(), "interval": [0.02, 0.04]}]}
    error = {
        "runs": 3,
        "terms": [{"name": "armature", "target": "shoulder", "mean": 0.01}],
        "covariance": [[1e-4]],
        "noise": [{"channel": "joint_torque", "kind": "shoulder", "level": 0.1}],
        "rates": {"shoulder": 0.02},
    }
    file.write_text(json.dumps(said | {"unchanged": error}))
    known = unchanged_beside(tmp_path / "effects.toml", [ROTOR])
    assert known is not None
    assert known.keys == (("armature", "shoulder"),)
    assert unchanged_beside(tmp_path / "effects.toml", []) is None
    silent = [{"channel": "joint_torque", "kind": "shoulder", "level": 0}]
    for damaged in (error | {"covariance": [[-1e-4]]}, error | {"noise": silent}, 3):
        file.write_text(json.dumps(said | {"unchanged": damaged}))
        refused("'unchanged' is damaged", unchanged_beside, tmp_path / "effects.toml", [ROTOR])


@pytest.fixture(scope="module")
def log():
    return swung(seed=0, seconds=14.0, armature=0.03)


@pytest.fixture
def three_blocks(monkeypatch):
    """Three blocks of four seconds instead of twenty of a minute."""
    monkeypatch.setattr(long_logs, "TRACED_BLOCKS", 3)
    monkeypatch.setattr(long_logs, "TRACED_BLOCK", 4.0)


def test_a_short_log_is_traced_whole(log, tmp_path):
    log.write(tmp_path / "short.parquet")
    assert in_blocks(log) == [log]
    (read,) = read_in_blocks(tmp_path / "short.parquet")
    np.testing.assert_array_equal(read.q, log.q)


@pytest.mark.parametrize("from_file", [True, False])
def test_blocks_are_spread_from_the_first_row_to_the_last(log, three_blocks, tmp_path, from_file):
    log.write(tmp_path / "long.parquet")
    blocks = read_in_blocks(tmp_path / "long.parquet") if from_file else in_blocks(log)
    rows = round(4.0 * log.meta.rate)
    assert [len(block.t) for block in blocks] == [rows] * 3
    middle = round((len(log.t) - rows) / 2)
    for block, first in zip(blocks, (0, middle, len(log.t) - rows), strict=True):
        for name in log.frame:
            np.testing.assert_array_equal(block.frame[name], log.frame[name][first : first + rows])
    assert len({block.name for block in blocks}) == 3


def test_a_fault_between_the_blocks_is_still_one(log, three_blocks, tmp_path):
    log.write(tmp_path / "long.parquet")
    frame = log.frame.copy()
    between = round(4.5 * log.meta.rate)
    frame.loc[between, "t"] = frame["t"][between - 1]
    table = pq.read_table(tmp_path / "long.parquet")
    column = table.schema.get_field_index("t")
    table = table.set_column(column, "t", [frame["t"].to_numpy()])
    pq.write_table(table, tmp_path / "bad.parquet")
    refused(str(between), read_in_blocks, tmp_path / "bad.parquet")


def test_the_report_says_on_how_much_of_a_log_it_stands(log, three_blocks, tmp_path):
    log.write(tmp_path / "long.parquet")
    main(["trace", str(tmp_path / "long.parquet"), "-o", str(tmp_path / "cli")])
    said = json.loads((tmp_path / "cli" / "trace.json").read_text())
    (note,) = [one for one in said["notes"] if "blocks" in one]
    assert "3 blocks of 4 s each" in note
    assert [e["name"] for e in said["effects"]] == ["armature"]
    assert said["effects"][0]["value"] == pytest.approx(0.03, rel=0.2)
    assert len(said["runs"]) == 3
