"""The guide of an own log, gone with a recording as a robot writes it: import --guess, the draft's
questions, align, import, compare.
"""

import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from surefoot import Log, Robot, Scenario, walk
from surefoot.extend import Ground, Segment
from surefoot.scenarios.cli.main import main
from surefoot.sim.log.schema import GROUPS

EPOCH = 1_700_000_000
"""Start of the robot's clock, which counts from 1970 [s]."""
STARTED = 7.3
"""Time at which the motion capture was started, on the robot's clock after EPOCH [s]."""
LEGS = ("FR", "FL", "RR", "RL")
"""The robot's order; its motors count through it."""
MOTORS = [f"{leg}_{part}" for leg in LEGS for part in ("hip", "thigh", "calf")]
SIGN = {joint: -1.0 if joint.endswith("calf") else 1.0 for joint in MOTORS}
MARKERS = np.array([0.05, 0.01, 0.12])
"""Position of the markers in the IMU frame [m]."""
TURNED = Rotation.from_euler("zy", [90.0, 3.0], degrees=True)
"""Attitude of the markers' body in the IMU frame."""


@pytest.fixture(scope="module")
def walked() -> Log:
    course = (Segment(2.0, forward=0.5, turn=0.3), Segment(2.0, forward=0.4, turn=-0.5))
    return walk(Scenario("own", course, Ground(0.8)), Robot.load("spot_class"), seed=2)


def robot_csv(log: Log, path: Path) -> None:
    """A row per ms and a bit, in ns since 1970, degrees, counts of a foot's sensor."""
    rng = np.random.default_rng(0)
    t = np.arange(log.t[10], log.t[-10], 1e-3)
    t += rng.normal(0.0, 5e-5, len(t))
    read = {name: np.interp(t, log.t, log.frame[name]) for name in log.frame}
    # Between the steps of the simulated encoders, since the robot's are finer.
    angles = [name for name in log.frame if name.startswith("q_") and "des" not in name]
    smooth = {name: uniform_filter1d(log.frame[name].to_numpy(), 9) for name in angles}
    read |= {name: np.interp(t, log.t, smooth[name]) for name in angles}
    columns = {"stamp_ns": EPOCH * 10**9 + np.round(1e9 * t).astype(np.int64)}
    columns |= {f"imu_gyro_{a}": np.degrees(read[f"gyro_{a}"]) for a in "xyz"}
    columns |= {f"imu_acc_{a}": read[f"accel_{a}"] for a in "xyz"}
    for theirs, ours in (("pos", "q"), ("vel", "dq")):
        columns |= {
            f"motor_{k}_{theirs}": np.degrees(SIGN[joint] * read[f"{ours}_{joint}"]).round(3)
            for k, joint in enumerate(MOTORS)
        }
    columns |= {f"foot_force_{leg}": np.round(1.7 * read[f"force_{leg}"] + 35.0) for leg in LEGS}
    pd.DataFrame(columns).to_csv(path, index=False, float_format="%.6f")


def mocap_csv(log: Log, path: Path) -> None:
    """Markers in mm every 10 ms, on the clock of the motion capture."""
    rows = log.frame.iloc[200:-200:5]
    R = Rotation.from_quat(rows[[f"ref_q_{a}" for a in "wxyz"]].to_numpy(), scalar_first=True)
    p = rows[[f"ref_p_{a}" for a in "xyz"]].to_numpy() + R.apply(MARKERS)
    q = (R * TURNED).as_quat()
    columns = {"time": rows["t"].to_numpy() - STARTED}
    columns |= {f"pos {a} [mm]": 1e3 * p[:, k] for k, a in enumerate("XYZ")}
    columns |= {f"rot {a}": q[:, k] for k, a in enumerate("XYZW")}
    pd.DataFrame(columns).to_csv(path, index=False, float_format="%.6f")


def answered(draft: str) -> str:
    """The draft by someone who knows the robot: its order of motors, and the calves' signs."""
    lines = []
    for line in (line.removesuffix(" # ?") for line in draft.splitlines()):
        if motor := re.match(r'(d?q)_\w+ = (.*"motor_(\d+)_.*) }$', line):
            joint = MOTORS[int(motor[3])]
            sign = ", sign = -1" if SIGN[joint] < 0.0 else ""
            line = f"{motor[1]}_{joint} = {motor[2]}{sign} }}"
        lines.append(line)
    return "\n".join(lines) + "\n"


def said(capsys, *arguments: str) -> str:
    main(list(arguments))
    return capsys.readouterr().out


def test_a_log_as_a_robot_writes_it_is_compared_after_one_wrong_turn(
    walked, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    robot_csv(walked, tmp_path / "robot.csv")
    mocap_csv(walked, tmp_path / "mocap.csv")

    # The draft has every column and unit; it asks for the order, the signs and the clock.
    files = ("robot.csv", "mocap.csv")
    said(capsys, "import", "--guess", *files, "--robot", "spot_class", "-o", "draft.toml")
    draft = Path("draft.toml").read_text()
    assert {'unit = "ns"', 'unit = "deg"', 'unit = "deg/s"', 'unit = "mm"'} <= {
        unit for line in draft.splitlines() for unit in re.findall(r'unit = "[^"]*"', line)
    }
    questions = "\n".join(line for line in draft.splitlines() if "# ?" in line)
    for asked in ("order", "signs", "clock", "surefoot align"):
        assert asked in questions
    Path("mine.toml").write_text(answered(draft))

    # The wrong turn: whoever imports before aligning is told what to do, in one line.
    with pytest.raises(SystemExit) as refused:
        main(["import", ".", "--map", "mine.toml", "-o", "mine.parquet"])
    captured = capsys.readouterr()
    line = f"{captured.err}{refused.value.code if isinstance(refused.value.code, str) else ''}"
    assert len(line.strip().splitlines()) == 1
    assert "another clock" in line
    assert "surefoot align" in line
    assert not Path("mine.parquet").exists()

    # What align prints goes into the map as it is, in place of the draft's own.
    out = said(capsys, "align", ".", "--map", "mine.toml", "-o", "alignment")
    pasted = out[out.index("[reference]\n") :]
    before, _, rest = Path("mine.toml").read_text().partition("[reference]\n")
    columns = rest[rest.index("[reference.columns]") :]
    Path("mine.toml").write_text(f"{before}{pasted}\n{columns}")
    found = json.loads(Path("alignment/alignment.json").read_text())
    assert abs(found["offset"] - (EPOCH + STARTED)) < 1e-3
    q_IM = [float(x) for x in re.findall(r"q_IM = \[(.*?)\]", pasted)[0].split(",")]
    off = Rotation.from_quat(q_IM, scalar_first=True) * TURNED.inv()
    assert np.degrees(off.magnitude()) < 1.0
    said(capsys, "import", ".", "--map", "mine.toml", "-o", "mine.parquet", "--strict")

    log = Log.read("mine.parquet")
    assert log.rate == pytest.approx(1000.0, rel=2e-3)
    assert abs(log.t[0] - walked.t[200]) < 5e-3  # rebased by whole seconds
    assert {"imu", "q", "dq", "contact", "reference"} <= {g for g in GROUPS if log.has(g)}
    for name, most in {"q": 1e-2, "dq": 1e-2, "gyro": 2e-2, "ref_p": 5e-3}.items():
        columns = [c for c in walked.frame if c.startswith(f"{name}_") and "des" not in c]
        for column in columns:
            expected = np.interp(log.t, walked.t, walked.frame[column])
            np.testing.assert_allclose(log.frame[column], expected, atol=most, err_msg=column)

    table = said(capsys, "compare", "mine.parquet", "-o", "compared")
    errors = re.findall(r"\| *leg *\| *([0-9.]+)", table)
    assert errors
    assert float(errors[0]) < 0.03
