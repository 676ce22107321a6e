"""The Log: what is written is read back exactly, and nothing broken gets in."""

import json
import pickle
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from refusals import refusal, refused

from surefoot.sim.log import (
    JOINTS,
    LEGS,
    SCHEMA,
    Log,
    LogError,
    LogReader,
    MemoisedLog,
    Meta,
    joint_velocity,
)
from surefoot.sim.log.file import ROW_GROUP

RATE = 500.0
REF_P = ("ref_p_x", "ref_p_y", "ref_p_z")
FUZZ = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def make_log(n: int = 40, seed: int = 0) -> Log:
    rng = np.random.default_rng(seed)
    columns = {"t": 12.0 + np.arange(n) / RATE}
    names = [f"{group}_{axis}" for group in ("gyro", "accel", "ref_p", "ref_v") for axis in "xyz"]
    names += [f"{group}_{joint}" for group in ("q", "dq", "tau") for joint in JOINTS]
    names += [f"{group}_{leg}" for group in ("force", "slip", "mu") for leg in LEGS]
    names += ["x_temperature"]
    columns |= {name: rng.normal(size=n) for name in names}
    q = rng.normal(size=(n, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    columns |= {f"ref_q_{axis}": q[:, i].copy() for i, axis in enumerate("wxyz")}
    columns |= {f"contact_{leg}": (rng.random(n) > 0.5).astype(float) for leg in LEGS}
    columns["ref_ok"] = (rng.random(n) > 0.1).astype(float)
    law = {"kp": [100.0] * 12, "kd": [2.0] * 12}
    effects = ({"name": "payload", "target": "all", "value": 2.0, "unit": "kg"},)
    meta = Meta(RATE, robot="spot_class", seed=3, motor_law=law, effects=effects)
    return Log(pd.DataFrame(columns), meta)


def written(log: Log, path: Path, metadata: dict | bytes | None = None) -> Path:
    """Write past the checks, as another program might."""
    if metadata is None:
        metadata = {"schema": SCHEMA, "rate": RATE}
    text = metadata if isinstance(metadata, bytes) else json.dumps(metadata).encode()
    table = pa.Table.from_pandas(log.frame, preserve_index=False)
    pq.write_table(table.replace_schema_metadata({b"surefoot": text}), path)
    return path


def fault(path: Path) -> str:
    message = refusal(Log.read, path, error=LogError)
    assert str(path) in message
    return message


def test_a_log_comes_back_bit_for_bit(tmp_path):
    log = make_log()
    log.write(tmp_path / "walk.parquet")
    back = Log.read(tmp_path / "walk.parquet")
    pd.testing.assert_frame_equal(back.frame, log.frame, check_exact=True)
    assert back.meta == log.meta
    stripped = written(log, tmp_path / "stripped.parquet", {"schema": SCHEMA, "rate": RATE})
    assert Log.read(stripped).meta == Meta(RATE)
    log.write(tmp_path / "again.parquet")
    assert (tmp_path / "again.parquet").read_bytes() == (tmp_path / "walk.parquet").read_bytes()


def test_arrays_are_contiguous_and_in_canonical_order():
    log = make_log()
    shuffled = replace(log, frame=log.frame[list(log.frame.columns[::-1])])
    assert shuffled.joints == JOINTS
    for name, shape in (("gyro", 3), ("q", 12), ("dq", 12), ("force", 4), ("ref_q", 4)):
        value = getattr(shuffled, name)
        assert value.shape == (40, shape)
        assert value.flags.c_contiguous
        np.testing.assert_array_equal(value, getattr(log, name))
    np.testing.assert_array_equal(log.q.reshape(-1, 4, 3)[:, 2, 1], log.frame["q_RL_thigh"])
    assert log.contact.dtype == bool
    assert log.ref_ok.dtype == bool
    np.testing.assert_allclose(np.linalg.det(log.ref_R_GI), 1.0)
    log.q[:] = 0.0  # arrays are new each time
    np.testing.assert_array_equal(log.q[:, 0], log.frame["q_FL_hip"])


def test_a_view_computes_each_array_once_and_those_of_replaced_columns_anew():
    log = make_log()
    view = MemoisedLog.of(log)
    moved = view.with_columns({"q_FL_hip": log.columns["q_FL_hip"] + 1.0})
    for name in ("t", "gyro", "q", "tau", "contact", "force", "ref_q", "ref_R_GI"):
        assert getattr(view, name) is getattr(view, name)
        np.testing.assert_array_equal(getattr(view, name), getattr(log, name))
    again = view.with_columns({"q_FL_hip": log.columns["q_FL_hip"] + 1.0})
    assert again.tau is view.tau
    assert again.ref_R_GI is view.ref_R_GI
    assert again.columns["q_FR_hip"] is view.columns["q_FR_hip"]
    for one in (moved, again):
        np.testing.assert_array_equal(one.q[:, 0], log.q[:, 0] + 1.0)
        np.testing.assert_array_equal(one.q[:, 1:], log.q[:, 1:])
    np.testing.assert_array_equal(view.q, log.q)


def test_a_view_derives_a_value_again_only_if_what_it_depends_on_changes():
    calls, robot, column = [], object(), np.zeros(40)

    def call() -> int:
        calls.append(None)
        return len(calls)

    def number_of_call(log: Log, given: object = robot) -> int:
        return log.once("number of the call", ["q", "x_temperature"], call, given)

    view = MemoisedLog.of(make_log())
    assert number_of_call(view) == number_of_call(view) == 1
    assert number_of_call(view.with_columns({"gyro_x": column, "dq_FL_hip": column})) == 1
    changed = [view.with_columns({name: column}) for name in ("q_RR_calf", "x_temperature", "t")]
    assert [number_of_call(one) for one in changed] == [2, 3, 4]
    assert number_of_call(view) == 1
    assert number_of_call(view, object()) == 5
    assert [number_of_call(make_log()) for _ in range(2)] == [6, 7]


def other_machine(joints: tuple[str, ...], legs: tuple[str, ...], n: int = 60) -> Log:
    rng = np.random.default_rng(1)
    columns = {"t": np.arange(n) / RATE}
    columns |= {f"{g}_{j}": rng.normal(size=n) for g in ("q", "dq", "tau", "q_des") for j in joints}
    columns |= {f"force_{leg}": rng.normal(size=n) for leg in legs}
    columns |= {f"contact_{leg}": (rng.random(n) > 0.5).astype(float) for leg in legs}
    return Log(pd.DataFrame(columns), Meta(RATE))


BIPED = tuple(f"{side}_{j}" for side in ("left", "right") for j in ("yaw", "roll", "hip", "knee"))


@pytest.mark.parametrize(
    ("joints", "legs"),
    [(BIPED, ("left", "right")), (("a1", "a2", "a3", "a4", "a5", "a6"), ()), (("shoulder",), ())],
    ids=["biped", "arm", "pendulum"],
)
def test_joints_and_legs_are_those_that_a_log_has(tmp_path, joints, legs):
    log = other_machine(joints, legs)
    log.write(tmp_path / "log.parquet")
    back = Log.read(tmp_path / "log.parquet")
    assert (back.joints, back.legs) == (joints, legs)
    assert back.q.shape == back.tau.shape == (60, len(joints))
    assert joint_velocity(without_rates(back, joints)).shape == (60, len(joints))
    np.testing.assert_array_equal(back.q_des[:, -1], log.frame[f"q_des_{joints[-1]}"])
    if legs:
        assert back.contact.shape == back.force.shape == (60, len(legs))
        np.testing.assert_array_equal(back.contact[:, 1], log.frame["contact_right"] == 1.0)
    else:
        with pytest.raises(LogError, match=r"lacks contact \(contact_<leg>\), force"):
            back.require("contact", "force")


def without_rates(log: Log, joints: tuple[str, ...]) -> Log:
    return replace(log, frame=log.frame.drop(columns=[f"dq_{joint}" for joint in joints]))


def test_a_missing_group_is_named_and_never_zero():
    log = without_rates(make_log(), JOINTS)
    assert log.has("tau")
    assert not log.has("dq")
    with pytest.raises(LogError, match=r"lacks dq \(dq_FL_hip"):
        _ = log.dq
    refused(r"lacks dq \(dq_FL_hip.*commands", log.require, "q", "dq", "commands", error=LogError)


def test_rows_keep_time_and_a_step_divides_the_rate():
    log = make_log()
    assert log.rows(slice(5, 15)).t[0] == log.t[5]
    thinned = log.rows(slice(None, None, 5))
    assert thinned.rate == RATE / 5
    assert len(thinned.t) == 8
    np.testing.assert_array_equal(log.rows(log.ref_ok).gyro, log.gyro[log.ref_ok])


def test_nothing_is_overwritten_without_force_and_nothing_half_written(tmp_path, monkeypatch):
    path = tmp_path / "walk.parquet"
    make_log(seed=1).write(path)
    before = path.read_bytes()
    refused("exists already", make_log(seed=2).write, path, error=LogError)
    monkeypatch.setattr("surefoot.sim.log.file.pq.ParquetWriter.write_table", _fail_half_way)
    refused("No space left", make_log(seed=2).write, path, force=True, error=LogError)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def _fail_half_way(writer, table, **options):
    raise OSError(28, "No space left on device")


def test_an_invalid_log_is_not_written(tmp_path):
    log, words = make_log(), "column gyro_y, row 7: NaN, for 1 row"
    log.frame.loc[7, "gyro_y"] = np.nan
    refused(words, log.write, tmp_path / "walk.parquet", error=LogError)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("column", "rows", "value", "said"),
    [
        ("accel_z", slice(11, 14), np.nan, "column accel_z, row 11: NaN, for 4 rows"),
        ("ref_q_w", slice(9, 9), 2.0, "row 9: not a unit quaternion"),
        ("contact_FL", slice(4, 4), 0.5, "column contact_FL, row 4: 0.5 is not 0 or 1"),
        ("t", slice(6, 6), 12.01, "column t, row 6: time stops"),
        ("t", slice(6, 6), 12.0, "column t, row 6: time jumps back"),
    ],
)
def test_bad_numbers_are_named_by_column_and_row(tmp_path, column, rows, value, said):
    log = make_log()
    log.frame.loc[rows, column] = value
    assert said in fault(written(log, tmp_path / "bad.parquet"))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda frame: frame[:0], "no rows"),
        (lambda frame: frame.drop(columns="t"), "column t is missing"),
        (lambda frame: frame.drop(columns="contact_RL"), "column contact_RL is missing"),
        (lambda frame: frame.drop(columns=list(REF_P)), "column ref_p_x is missing"),
        (lambda frame: frame.rename(columns={"mu_FL": "mu"}), "unknown column mu"),
        (lambda frame: frame.astype({"mu_FL": "float32"}), "column mu_FL has type"),
        (lambda frame: frame.astype({"mu_FL": "str"}), "column mu_FL has type"),
    ],
)
def test_bad_columns_are_named(tmp_path, change, said):
    log = make_log()
    log = replace(log, frame=change(log.frame))
    assert said in fault(written(log, tmp_path / "bad.parquet"))


@pytest.mark.parametrize(
    ("metadata", "said"),
    [
        ({"rate": RATE}, "metadata: schema is missing"),
        ({"schema": SCHEMA, "rate": 10.0}, "runs at 500 Hz, the metadata says 10"),
        (b"{", "not JSON"),
        (b"[1]", "not a JSON object"),
    ],
)
def test_bad_metadata_is_named(tmp_path, metadata, said):
    assert said in fault(written(make_log(), tmp_path / "bad.parquet", metadata))


def test_files_that_are_no_logs(tmp_path):
    assert "No such file" in fault(tmp_path / "nowhere.parquet")
    assert "is a folder" in fault(tmp_path)
    (tmp_path / "text.parquet").write_text("t,gyro_x\n0,1\n")
    assert "not a whole Parquet file" in fault(tmp_path / "text.parquet")
    pq.write_table(pa.table({"t": [0.0, 1.0]}), tmp_path / "bare.parquet")
    assert "no 'surefoot' metadata" in fault(tmp_path / "bare.parquet")
    twice = pa.Table.from_pandas(make_log().frame, preserve_index=False)
    pq.write_table(twice.append_column("gyro_x", twice["gyro_x"]), tmp_path / "twice.parquet")
    assert "column gyro_x is there more than once" in fault(tmp_path / "twice.parquet")


@FUZZ
@given(place=st.floats(0.0, 1.0, exclude_max=True), flip=st.integers(1, 255))
def test_a_damaged_file_is_an_error_or_a_valid_log(tmp_path, place, flip):
    """Cut short it is an error; with a byte that is another, it may be either."""
    path = tmp_path / "walk.parquet"
    make_log(5).write(path, force=True)
    content = bytearray(path.read_bytes())
    at = int(place * len(content))
    path.write_bytes(content[:at])
    fault(path)
    content[at] ^= flip
    path.write_bytes(content)
    with suppress(LogError):
        assert np.isfinite(Log.read(path).frame.to_numpy()).all()


@FUZZ
@given(
    column=st.sampled_from([*make_log(2).frame.columns]),
    row=st.integers(0, 39),
    value=st.sampled_from([np.nan, np.inf, -np.inf]),
)
def test_any_bad_cell_is_found(tmp_path, column, row, value):
    log = make_log()
    log.frame.loc[row, column] = value
    assert f"column {column}, row {row}" in fault(written(log, tmp_path / "bad.parquet"))


@pytest.mark.parametrize("seconds", [0.0, 0.02, 0.2, 7.0, np.inf])
def test_chunks_are_the_rows_in_turn_each_once(tmp_path, seconds):
    log = make_log(203)
    path = tmp_path / "walk.parquet"
    log.write(path)
    reader = LogReader(path)
    assert (reader.rows, reader.meta, reader.columns) == (203, log.meta, tuple(log.frame.columns))
    chunks = list(Log.chunks(reader, seconds))
    size = max(1, round(min(seconds * RATE, 203)))
    assert [len(c.t) for c in chunks[:-1]] == [size] * (len(chunks) - 1)
    assert all(c.meta == log.meta and c.name == "walk" for c in chunks)
    whole = pd.concat([c.frame for c in chunks], ignore_index=True)
    pd.testing.assert_frame_equal(whole, log.frame, check_exact=True)


def test_columns_of_very_many_short_row_groups_are_refused(tmp_path, monkeypatch):
    """Each takes some 50 us to find, so that 10 000 groups would take a minute."""
    path = tmp_path / "log.parquet"
    make_log(40).write(path)
    pq.write_table(pq.read_table(path), path, row_group_size=1)
    assert LogReader(path).rows == 40
    monkeypatch.setenv("SUREFOOT_LIMITS", "items=1000")
    with pytest.raises(LogError, match=r"log\.parquet: columns of row groups with less than 1000"):
        LogReader(path)


def test_a_long_log_is_in_many_row_groups_and_a_chunk_crosses_them(tmp_path):
    t = np.arange(3 * ROW_GROUP + 17) / RATE
    log = Log(pd.DataFrame({"t": t, "q_shoulder": np.sin(t)}), Meta(RATE))
    log.write(tmp_path / "long.parquet")
    groups = pq.ParquetFile(tmp_path / "long.parquet").metadata
    rows = [groups.row_group(i).num_rows for i in range(groups.num_row_groups)]
    assert rows == [ROW_GROUP] * 3 + [17]
    chunks = list(Log.chunks(LogReader(tmp_path / "long.parquet"), 100.0))
    assert [len(c.t) for c in chunks] == [50_000, 48_321]
    np.testing.assert_array_equal(np.concatenate([c.q for c in chunks]), log.q)


def test_a_log_is_read_in_the_memory_of_a_chunk(tmp_path):
    t = np.arange(20 * ROW_GROUP) / RATE
    rng = np.random.default_rng(0)
    columns = {"t": t} | {f"q_{j}": rng.normal(size=len(t)) for j in JOINTS}
    Log(pd.DataFrame(columns), Meta(RATE)).write(tmp_path / "long.parquet")
    whole = 8 * len(t) * len(columns)
    del columns, t
    before = pa.total_allocated_bytes()
    most = 0
    for _ in Log.chunks(LogReader(tmp_path / "long.parquet"), 10.0):
        most = max(most, pa.total_allocated_bytes() - before)
    assert most < 0.2 * whole


@pytest.mark.parametrize(
    ("row", "column", "value", "said"),
    [
        (500, "t", 12.0, "column t, row 500: time jumps back"),
        (777, "gyro_x", np.nan, "column gyro_x, row 777: NaN"),
        (999, "contact_FL", 0.5, "column contact_FL, row 999: 0.5 is not 0 or 1"),
    ],
)
def test_a_fault_is_found_across_chunks_with_its_row_in_the_log(tmp_path, row, column, value, said):
    log = make_log(1003)
    log.frame.loc[row, column] = value
    chunks = Log.chunks(LogReader(written(log, tmp_path / "bad.parquet")), 1.0)
    assert len(next(chunks).t) == 500
    refused(f"bad.parquet: {said}", list, chunks, error=LogError)


@pytest.mark.parametrize("made", [make_log, lambda: MemoisedLog.of(make_log())])
def test_replaced_columns_are_in_the_frame(made):
    log = made()
    once = log.with_columns({"gyro_x": np.ones(40)})
    twice = once.with_columns({"gyro_x": np.full(40, 2.0)})
    assert (twice.gyro[:, 0] == 2.0).all()
    copied = pickle.loads(pickle.dumps(twice))
    for one, size in ((once, 1.0), (twice, 2.0), (copied, 2.0), (replace(twice, name="b"), 2.0)):
        assert list(one.frame) == list(log.frame)
        np.testing.assert_array_equal(one.frame["gyro_x"], size)
        np.testing.assert_array_equal(one.frame["gyro_y"], log.frame["gyro_y"])
    added = twice.with_columns({"x_new": np.zeros(40), "contact_extra": np.ones(40)})
    assert list(added.frame) == [*log.frame, "x_new", "contact_extra"]
    assert "extra" in added.legs
