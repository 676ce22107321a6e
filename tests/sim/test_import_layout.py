"""Texts of other makes' layouts: drafted, and then read as the draft says, without a question of
separators, preambles or decimals left."""

import numpy as np
import pandas as pd
import pytest
from recorded import csv, drafted, imported
from refusals import refused
from written import written

from surefoot.sim.importing.guessing.guess import guess_map
from surefoot.sim.importing.readers.text import encoding_of, layout_of

N = 400
T = 0.01 * np.arange(N)
TURN = 0.2 * np.sin(T)
IMU = pd.DataFrame(
    {"t": T, "gyro_x": 0.0 * T, "gyro_y": 0.0 * T, "gyro_z": 0.2 * np.cos(T)}
    | {"accel_x": 0.01 * np.sin(9.0 * T), "accel_y": 0.01 * np.cos(7.0 * T), "accel_z": 9.81}
)
POSE = pd.DataFrame(
    {"t": T, "p_x": 0.1 * T, "p_y": 0.0 * T, "p_z": 0.3 + 0.0 * T}
    | {"q_w": np.cos(TURN / 2.0), "q_x": 0.0 * T, "q_y": 0.0 * T, "q_z": np.sin(TURN / 2.0)}
)
BOTH = pd.concat([IMU, POSE.drop(columns="t").add_prefix("vicon_")], axis=1)
EUROC = {"t": "#timestamp [ns]"} | {
    f"{long}_{a}": f"{short}_RS_S_{a} [{unit}]"
    for long, short, unit in (("gyro", "w", "rad s^-1"), ("accel", "a", "m s^-2"))
    for a in "xyz"
}


def read(folder, *files):
    """The log of these files by their draft, and the draft."""
    paths = [folder / name for name in files]
    draft = guess_map(paths)
    return imported(paths, draft), draft


@pytest.mark.parametrize(
    ("before", "options", "layout"),
    [
        ("", {}, {}),
        ("", {"sep": "\t"}, {}),
        ("", {"sep": ";", "decimal": ","}, {"separator": ";", "decimal": ","}),
        ("", {"sep": " ", "decimal": ","}, {"separator": r"\s+", "decimal": ","}),
        ("", {"quoting": 1}, {}),
        ("# a robot\n# and its day\n", {}, {"skip": 2}),
        ("Recorded by hand\nDay;3\n\n", {"sep": ";"}, {"skip": 3}),
    ],
)
def test_a_text_is_read_as_it_is_laid_out(tmp_path, before, options, layout):
    (tmp_path / "run.csv").write_text(before + BOTH.to_csv(index=False, **options))
    assert layout_of(tmp_path / "run.csv") == layout
    log, _ = read(tmp_path, "run.csv")
    np.testing.assert_allclose(log.gyro, IMU.to_numpy()[:, 1:4], atol=1e-9)
    np.testing.assert_allclose(log.ref_p[:, 0], 0.1 * T, atol=1e-6)


def test_the_tables_of_a_folder_are_drafted_together(tmp_path):
    csv(tmp_path, IMU, "imu.csv")
    csv(tmp_path, POSE.add_prefix("vicon_"), "truth.csv")
    (tmp_path / "notes.txt").write_text("a walk in the hall\n")
    draft = guess_map([tmp_path])
    assert (draft.file, draft.reference_file) == (tmp_path / "imu.csv", tmp_path / "truth.csv")


def test_rows_without_times_have_the_rate_by_which_angles_change_as_their_rates_say(tmp_path):
    """And the draft says so, or no log could be read by it."""
    angles = {"q_knee": 0.5 * np.sin(3.0 * T), "dq_knee": 1.5 * np.cos(3.0 * T)}
    csv(tmp_path, angles)
    log, draft = read(tmp_path, "run.csv")
    assert draft.rate is not None
    assert draft.rate[0] == pytest.approx(100.0, rel=0.02)
    np.testing.assert_allclose(log.t, np.arange(N) / draft.rate[0], rtol=1e-4)
    np.testing.assert_allclose(log.q[:, 0], angles["q_knee"], atol=1e-9)


def test_blanks_around_a_name_are_no_part_of_it(tmp_path):
    rows = IMU.to_csv(index=False, header=False)
    (tmp_path / "run.csv").write_text(" ,\t".join(map(str, IMU)) + " \n" + rows)
    log, draft = read(tmp_path, "run.csv")
    assert [entry.theirs for entry in draft.main] == [entry.name for entry in draft.main]
    np.testing.assert_allclose(log.gyro, IMU.to_numpy()[:, 1:4], atol=1e-9)


def test_a_text_of_comments_alone_has_no_times(tmp_path):
    (tmp_path / "run.csv").write_text("# t,gyro_x\n# 0.0,1.0\n# 0.1,1.0\n")
    assert layout_of(tmp_path / "run.csv") == {}
    assert "t" not in {entry.name for entry in guess_map([tmp_path / "run.csv"]).main}


@pytest.mark.parametrize("rows", [2, 3, 5, 20, 70])
def test_a_few_rows_are_drafted(tmp_path, rows):
    """Fewer than the windows in which units are looked for."""
    found = {entry.name for entry in drafted(tmp_path, IMU[:rows]).main}
    assert found >= {f"gyro_{axis}" for axis in "xyz"}


def test_the_files_of_euroc_and_a_trajectory_of_tum_go_in_as_they_are(tmp_path):
    imu = IMU.assign(t=(1.4e18 + 1e9 * T).astype(np.int64)).rename(columns=EUROC)
    imu.to_csv(tmp_path / "imu0.csv", index=False)
    euroc = {c: f"{c[0]}_RS_R_{c[-1]} [m]" if c[0] == "p" else f"q_RS_{c[-1]} []" for c in POSE}
    poses = POSE.assign(t=imu.iloc[:, 0]).rename(columns=euroc | {"t": "#timestamp"})
    poses.to_csv(tmp_path / "truth.csv", index=False)
    log, draft = read(tmp_path, "truth.csv", "imu0.csv")
    assert not any(entry.doubt for entry in (*draft.main, *draft.reference))
    np.testing.assert_allclose(log.ref_p[:, 0], 0.1 * T, atol=1e-6)
    # Of TUM: spaces, a sign of a comment before the names, w last.
    csv(tmp_path, IMU, "imu.csv")
    order = ["t", "p_x", "p_y", "p_z", "q_x", "q_y", "q_z", "q_w"]
    rows = POSE[order].to_csv(sep=" ", header=False, index=False)
    (tmp_path / "run.tum").write_text(f"# timestamp tx ty tz qx qy qz qw\n{rows}")
    log, _ = read(tmp_path, "imu.csv", "run.tum")
    turned = 2.0 * np.arctan2(log.ref_q[:, 3], log.ref_q[:, 0])
    np.testing.assert_allclose(turned, TURN, atol=1e-6)


@pytest.mark.parametrize(
    "encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16", "utf-16-le", "utf-16-be"]
)
def test_a_spreadsheet_is_read_in_the_letters_that_it_writes(tmp_path, encoding):
    table = IMU.assign(**{"Temperatur [°C]": 21.5})
    text = "Gerät;Müller\n" + table.to_csv(index=False, sep=";", decimal=",")
    (tmp_path / "run.csv").write_bytes(text.encode(encoding))
    log, _ = read(tmp_path, "run.csv")
    np.testing.assert_allclose(log.gyro, IMU.to_numpy()[:, 1:4], atol=1e-9)


def test_what_is_no_text_is_still_refused(tmp_path):
    path = written(tmp_path / "run.csv", b"\x89PNG\r\n\x1a\n\0\0\xff" * 9)
    refused("not a readable table", guess_map, [path])


def test_a_gyro_that_turns_slowly_has_the_unit_that_its_name_says(tmp_path):
    """Ten degrees a second about the vertical: neither gravity nor their size tells the unit."""
    slow = {f"gyro_{a}": f"Gyro {a} [°/s]" for a in "xyz"}
    theirs = IMU.assign(**{name: np.degrees(IMU[name]) for name in slow}).rename(columns=slow)
    csv(tmp_path, theirs)
    log, draft = read(tmp_path, "run.csv")
    np.testing.assert_allclose(log.gyro, IMU.to_numpy()[:, 1:4], atol=1e-9)
    assert not [e.name for e in draft.main if e.doubt]


@pytest.mark.parametrize("content", [b"a", b"7"])
def test_one_letter_is_no_utf_16(tmp_path, content):
    """Every other byte of one byte is none, and so not zero."""
    assert encoding_of(written(tmp_path / "one.csv", content)) == "utf-8-sig"
