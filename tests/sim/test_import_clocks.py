"""Stamps that are wrong: each costs its row, is said, and changes no other; clocks that count from
an epoch are rebased."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from recorded import POSE, SENSORS, UNIX, as_named, csv, drafted, poses
from refusals import refusal, refused
from written import written

from surefoot.sim.importing.recording import read_recording
from surefoot.sim.log import Log
from surefoot.sim.plausibility import check_log

N, STEP = 400, 0.01
COLUMNS = as_named((*SENSORS, "q_knee", "dq_knee")) + "t = { column = 't', unit = 'UNIT' }\n"
REFERENCE = "[reference]\nfile = 'mocap.csv'\nOFFSET\n"
REFERENCE += as_named(("t", *POSE), "reference.columns")


def table(t=None, count=N) -> pd.DataFrame:
    """A knee that swings and an IMU at rest, with noise that makes each row unlike the others."""
    rng = np.random.default_rng(0)
    t = STEP * np.arange(count) if t is None else np.asarray(t)
    frame = pd.DataFrame({"t": t} | {name: 0.01 * rng.normal(size=len(t)) for name in SENSORS})
    frame["accel_z"] += 9.81
    frame["q_knee"] = np.sin(6.0 * STEP * np.arange(len(t)))
    frame["dq_knee"] = 6.0 * np.cos(6.0 * STEP * np.arange(len(t)))
    return frame


def read(folder: Path, frame: pd.DataFrame, unit="s", mocap=None, offset="") -> tuple[Log, str]:
    """The log of a table, and the notes of its import."""
    frame.to_csv(folder / "robot.csv", index=False)
    text = COLUMNS.replace("UNIT", unit)
    if mocap is not None:
        mocap.to_csv(folder / "mocap.csv", index=False)
        text += REFERENCE.replace("OFFSET", offset)
    (folder / "map.toml").write_text(text)
    found = read_recording(folder / "robot.csv", folder / "map.toml")
    return found.log(), "\n".join(found.notes)


def stamped(row: int, value: float) -> pd.DataFrame:
    frame = table()
    frame.loc[row, "t"] = value
    return frame


def again(*rows: int, **other: float) -> pd.DataFrame:
    """Rows that come twice, the second time with other values."""
    frame = table()
    parts = [frame, frame.loc[list(rows)].assign(**other)]
    return pd.concat(parts).sort_index(kind="stable").reset_index(drop=True)


def swapped() -> pd.DataFrame:
    frame = table()
    order = np.arange(N)
    order[[200, 201]] = 201, 200
    return frame.loc[order].reset_index(drop=True)


ONE_BAD_STAMP = {
    "a sample that is repeated": (again(50), 0, "repeated"),
    "a sample that is sent again later": (
        pd.concat([table()[:100], table()[90:95], table()[100:]], ignore_index=True), 0, "5 ",
    ),
    "a stamp with two values": (again(50, gyro_x=0.5), 0, "line 53"),
    "a stamp that leaps ahead": (stamped(200, 99.0), 1, "line 202"),
    "a stamp of zero": (stamped(200, 0.0), 1, "line 202"),
    "a first stamp of zero, then Unix time": (
        table(np.concatenate([[0.0], UNIX + STEP * np.arange(1, N)])), 1, "line 2",
    ),
    "a last stamp far ahead": (stamped(N - 1, 5e5), 1, "line 401"),
    "two rows in the other order": (swapped(), 1, "line 20"),
}  # fmt: skip


@pytest.mark.parametrize("case", ONE_BAD_STAMP)
def test_a_stamp_that_is_wrong_costs_its_row_and_no_other(tmp_path, case):
    frame, lost, said = ONE_BAD_STAMP[case]
    log, notes = read(tmp_path, frame)
    assert len(log.t) == N - lost
    assert log.rate == pytest.approx(1.0 / STEP)
    np.testing.assert_allclose(log.t[-1] - log.t[0], (N - 1) * STEP, atol=1.01 * STEP)
    knee = np.interp(log.t - log.t[0], STEP * np.arange(N), table()["q_knee"])
    np.testing.assert_allclose(log.frame["q_knee"], knee, atol=0.06)
    assert said in notes
    assert len(notes.splitlines()) == 1 + ("Unix" in case)


def restarted(t, rows=N // 2):
    """Times that go back by `rows` in the middle, and on from there."""
    return np.concatenate([t[: N // 2], t[N // 2 - rows : N - rows] + 0.5 * STEP])


CONTRADICTORY = {
    "a clock that is restarted": (restarted(STEP * np.arange(N)), ("line 202", "1.99 s")),
    "a clock that goes back by a few rows": (
        restarted(STEP * np.arange(N), 8), ("line 202", "1.99 s then 1.925 s"),
    ),
    "restarted in Unix time": (
        restarted(UNIX + STEP * np.arange(N)), ("line 202", "1700000001.99 s"),
    ),
    "stamps coarser than the rows": (np.repeat(2 * STEP * np.arange(N // 2), 2), ("rate",)),
    "one stamp throughout": (np.zeros(N), ("rate",)),
    "time that runs backwards": (STEP * np.arange(N)[::-1], ("line 3",)),
}  # fmt: skip


@pytest.mark.parametrize("case", CONTRADICTORY)
def test_stamps_that_contradict_each_other_are_refused_with_their_numbers(tmp_path, case):
    t, said = CONTRADICTORY[case]
    message = refusal(read, tmp_path, table(t))
    assert all(one in message for one in ("robot.csv: column 't'", *said)), message


EVEN = STEP * np.arange(N)


def leaping(row: int, seconds: float, t=EVEN) -> np.ndarray:
    return t + seconds * (np.arange(N) >= row)


SET = {  # times of the rows, of the reference, words of the notes, words of the finding
    "forward within the reference": (leaping(200, 0.15), EVEN, (), "clock was set"),
    "forward out of the reference": (leaping(200, 120.0), EVEN, ("200 of 400", "that was set"), ""),
    "by an hour, in Unix time": (
        leaping(150, 3600.0, UNIX + EVEN), UNIX + EVEN, ("250 of 400", "leap from 1.49 to"), ""),
    "to Unix time, of a robot that has booted": (
        leaping(201, float(UNIX)), EVEN, ("199 of 400", "clock that was set"), ""),
    "without a reference": (leaping(201, 120.0), None, (), "clock was set"),
    "a pause of the recording": (
        np.delete(EVEN, np.s_[150:230]), None, (), "lost rows"),
    "rows that were held up for a while": (
        np.where((EVEN > 1.495) & (EVEN < 1.895), 1.885 + 1e-2 * (EVEN - 1.5), EVEN),
        None, (), "lost rows"),
    "a reference that ends early": (EVEN, EVEN[:300], ("100 of 400",), ""),
    "a reference of all rows but a few": (EVEN, EVEN[:390], (), ""),
}  # fmt: skip


@pytest.mark.parametrize("case", SET)
def test_a_clock_that_was_set_is_told_from_rows_that_are_missing(tmp_path, case):
    t, of_reference, noted, found = SET[case]
    frame = table(t)
    if len(t) < N:
        frame["q_knee"] = np.sin(6.0 * t)
    mocap = None if of_reference is None else poses(of_reference, 1e-3)
    log, notes = read(tmp_path, frame, mocap=mocap)
    assert [one in notes for one in noted] == [True] * len(noted), notes
    assert ("left out" in notes) == bool(noted)
    assert ("clock" in notes.replace("recording's clock", "")) == ("leap" in notes)
    assert [
        one.line for one in check_log(log) if one.streams == ("t",) and found not in one.line
    ] == []
    assert any(one.streams == ("t",) for one in check_log(log)) == bool(found)


def test_a_reference_and_a_further_file_lose_single_rows_too(tmp_path):
    mocap = poses(STEP * np.arange(N), 1e-3)
    mocap = pd.concat([mocap[:100], mocap[99:]], ignore_index=True)
    mocap.loc[200, "t"] = 0.0
    feet = pd.DataFrame({"t": STEP * np.arange(N), "on": 1.0})
    feet.loc[10, "t"] = 50.0
    for name, columns in (("feet", feet), ("robot", table()), ("mocap", mocap)):
        csv(tmp_path, columns, f"{name}.csv")
    more = "x_on = 'feet:on'\n[sources.feet]\nfile = 'feet.csv'\nt = 't'\n"
    text = COLUMNS.replace("UNIT", "s") + more + REFERENCE.replace("OFFSET", "")
    found = read_recording(tmp_path / "robot.csv", written(tmp_path / "map.toml", text))
    assert found.poses is not None
    assert len(found.poses.t) == N - 1
    assert len(found.log().t) == N
    notes = "\n".join(found.notes)
    assert "mocap.csv" in notes
    assert "feet.csv" in notes


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
@pytest.mark.parametrize("clocks", ["both", "the robot's", "the reference's"])
def test_clocks_that_count_from_an_epoch_are_rebased(tmp_path, unit, clocks):
    """The reference begins half a second after the first row."""
    size = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[unit]
    steps = np.arange(N) * round(STEP * 1000) * size // 1000 if size > 1 else STEP * np.arange(N)
    frame = table(UNIX * size + steps if clocks != "the reference's" else 37 * size + steps)
    seen = STEP * np.arange(50, N - 50)
    mocap = poses(seen + UNIX if clocks != "the robot's" else seen, 1e-3)
    offset = {"both": 0, "the robot's": UNIX, "the reference's": 37 - UNIX}[clocks]
    log, notes = read(tmp_path, frame, unit, mocap, f"offset = {float(offset):.1f}")
    begin = 37.0 if clocks == "the reference's" else 0.0
    np.testing.assert_allclose(log.t, begin + STEP * np.arange(50, N - 50), atol=1e-6)
    np.testing.assert_allclose(log.ref_p[:, 0], np.arange(N - 100) * 1e-3, atol=1e-6)
    assert (str(UNIX) in notes) == (clocks != "the reference's")
    if offset:
        message = refusal(read, tmp_path, frame, unit, mocap)
        assert "surefoot align" in message
        assert "[reference] offset" in message
        assert "e+09" not in message


DRAFTED = {
    "as recorded": (table(), ()),
    "a sample that is repeated": (again(50), ()),
    "a stamp of zero": (stamped(200, 0.0), ()),
    "two rows in the other order": (swapped(), ()),
    "a pause of ten seconds": (table().assign(t=lambda x: x["t"] + 10.0 * (x["t"] > 2)), ()),
    "a reading that is not a number": (
        table().assign(accel_x=lambda x: x["accel_x"].where(x.index != 7)), ()),
    "rates that are not numbers": (table().assign(dq_knee=np.nan), ("dq_knee",)),
}  # fmt: skip


@pytest.mark.parametrize("case", DRAFTED)
def test_one_bad_value_changes_no_other_entry_of_a_draft(tmp_path, case):
    frame, without = DRAFTED[case]
    found, good = (
        {e.name: (e.theirs, e.unit) for e in drafted(tmp_path, columns).main}
        for columns in (frame, table())
    )
    assert found == {name: of for name, of in good.items() if name not in without}


def test_a_column_without_a_number_is_left_out_and_said(tmp_path):
    log, notes = read(tmp_path, table().assign(dq_knee=np.nan))
    assert "dq_knee" not in log.frame
    assert "dq_knee" in notes
    log, _ = read(tmp_path, table())
    assert "dq_knee" in log.frame
    refused(r"gyro_x.*NaN", read, tmp_path, table().assign(gyro_x=np.nan))
