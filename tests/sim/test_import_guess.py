"""Drafts of maps: how many of their entries are right, and that no wrong one is without a doubt."""

import numpy as np
import pandas as pd
import pytest

from surefoot.scenarios.cli.main import main
from surefoot.sim.common.files import measured_folder
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.importing.guess import Draft, guess_map, stride_in_turns
from surefoot.sim.importing.map import ImportMap
from surefoot.sim.importing.recording import import_log
from surefoot.sim.log import JOINTS, LEGS, Log
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk

MEASURED = measured_folder()
Truth = dict[str, tuple[str, float, float]]
"""Their column, scale and offset of each column of the log."""
ENOUGH = 0.9


def truth_of(name: str, **more: str) -> Truth:
    """What a bundled map says, and columns in SI that it leaves out."""
    rules = ImportMap.read(name)
    found = {}
    for columns in (rules.columns, rules.reference_columns):
        for column, one in columns.items():
            key = f"reference {column}" if columns is rules.reference_columns else column
            label = f"{one.source}:" if one.source else ""
            theirs = one.theirs
            for place, joint in enumerate(rules.source.names):
                theirs = theirs.replace(f"[{joint}]", f"[{place}]")
            found[key] = (label + theirs, one.scale, one.offset)
    return found | {column: (theirs, 1.0, 0.0) for column, theirs in more.items()}


def drafted(draft: Draft) -> dict[str, tuple[str, float, float, str]]:
    main = {e.name: (e.theirs, e.scale, e.offset, e.doubt) for e in draft.main}
    poses = {f"reference {e.name}": (e.theirs, e.scale, e.offset, e.doubt) for e in draft.reference}
    return main | poses


def same(a: tuple, b: tuple) -> bool:
    """Whether two entries read the same; the place of a single column may be left out."""
    plain = (str(x[0]).removesuffix("[0]") for x in (a, b))
    return len(set(plain)) == 1 and a[1] == pytest.approx(b[1]) and a[2] == pytest.approx(b[2])


def judged(draft: Draft, truth: Truth) -> tuple[int, int, list[str]]:
    """Entries that are right, entries of the truth, and wrong ones without a doubt."""
    found = drafted(draft)
    right = sum(name in found and same(found[name], one) for name, one in truth.items())
    silent = [
        name
        for name, one in found.items()
        if not one[3] and not (name in truth and same(one, truth[name]))
    ]
    return right, len(truth), silent


MEASURED_LOGS = {
    "go1_square": (("imu_joints.csv", "reference_recounted.csv"), truth_of("go1_square")),
    "go2_in_air": (("joints.csv",), truth_of("go2_in_air")),
    "ak80_pendulum": (("pd_measured.csv",), truth_of("ak80_pendulum")),
    "so101": (("prbs_excitation",), truth_of("so101")),
    "icub_biped": (("walking.mat",), truth_of("icub_biped")),
    "scaler_trot": (
        ("logs/scaler_06.csv", "reference/scaler_06_vicon.csv"),
        truth_of("scaler_trot"),
    ),
    "ricmonk": (
        ("csv/r01.csv",),
        {k: v for k, v in truth_of("ricmonk_run").items() if not k.startswith("x_")}
        | {f"q_des_{j}": (f"q_{j}_des_rad", 1.0, 0.0) for j in ("hook", "tail", "phi")},
    ),
}


@pytest.mark.skipif(not MEASURED.is_dir(), reason=f"the measured logs are not here ({MEASURED})")
def test_nine_entries_of_ten_are_right_on_measured_logs(capsys):
    rights, totals, said = 0, 0, []
    for folder, (files, truth) in MEASURED_LOGS.items():
        draft = guess_map([MEASURED / folder / one for one in files])
        if folder == "ak80_pendulum":  # its one joint has no name in the file
            truth = {name.replace("shoulder", "joint"): one for name, one in truth.items()}
        if folder == "so101":  # names of one's own
            truth = {name.replace("x_effort", "x_tau"): one for name, one in truth.items()}
        right, total, silent = judged(draft, truth)
        extra = [name for name in silent if name not in truth]
        said.append(f"{folder}: {right} of {total} entries right, beyond the map {extra}")
        assert not [name for name in silent if name in truth], said[-1]
        rights, totals = rights + right, totals + total
    with capsys.disabled():
        print("\n".join(["", *said, f"all: {rights} of {totals}, {100 * rights / totals:.1f} %"]))
    assert rights >= ENOUGH * totals


PARTS = {"hip": "HAA", "thigh": "HFE", "calf": "KFE"}
ANYMAL = {"FL": "LF", "FR": "RF", "RL": "LH", "RR": "RH"}


def in_the_manner_of(manner: str, name: str) -> tuple[str, float]:
    """Another's name for a column of the log, and what its values are multiplied by."""
    kind, _, rest = name.partition("_")
    leg, _, part = rest.partition("_")
    if manner == "short":
        short = {"gyro": "w", "accel": "a", "ref_p": "p", "ref_q": "q"}
        for long, letter in short.items():
            if name.startswith(f"{long}_"):
                return letter + name[-1], 1.0
        return {"t": "time"}.get(name, name.upper() if kind == "contact" else name), 1.0
    if manner == "ros":
        longer = {
            "gyro": "imu.angular_velocity.",
            "accel": "imu.linear_acceleration.",
            "q": f"joint_states.position.{ANYMAL.get(leg, leg)}_{PARTS.get(part, part)}",
            "dq": f"joint_states.velocity.{ANYMAL.get(leg, leg)}_{PARTS.get(part, part)}",
            "tau": f"joint_states.effort.{ANYMAL.get(leg, leg)}_{PARTS.get(part, part)}",
            "contact": f"contacts.{ANYMAL.get(leg, leg)}",
        }
        if name == "t":
            return "stamp_ns", 1e9
        if name.startswith("ref_p"):
            return f"mocap.pose.position.{name[-1]}", 1.0
        if name.startswith("ref_q"):
            return f"mocap.pose.orientation.{name[-1]}", 1.0
        return longer[kind] + (name[-1] if kind in ("gyro", "accel") else ""), 1.0
    degrees = 180.0 / np.pi
    place = JOINTS.index(rest) if rest in JOINTS else -1
    if manner == "degrees":
        if name == "t":
            return "Time_ms", 1e3
        if name.startswith("ref_"):
            return f"vicon_{'pos' if name[4] == 'p' else 'quat'}_{name[-1]}", 1.0
        return {
            "gyro": (f"Gyro{rest.upper()}", degrees),
            "accel": (f"Acc{rest.upper()}", 1.0 / 9.80665),
            "q": (f"motor{place}.q", degrees),
            "dq": (f"motor{place}.dq", degrees),
            "tau": (f"motor{place}.tau", 1.0),
            "contact": (f"footContact_{rest}", 1.0),
        }[kind]
    raise AssertionError(manner)


@pytest.fixture(scope="module")
def walked() -> Log:
    course = (Segment(3.0, 0.4), Segment(5.0, 0.4, turn=0.5), Segment(5.0, 0.4, turn=-0.5))
    return walk(Scenario("turning", course, Ground(0.8)), Robot.load("spot_class"), seed=0)


@pytest.mark.parametrize("manner", ["short", "ros", "degrees"])
def test_a_simulated_log_with_columns_renamed_and_shuffled_is_drafted(tmp_path, walked, manner):
    wanted = ("t", "gyro_", "accel_", "q_", "dq_", "tau_", "contact_", "ref_p_", "ref_q_")
    kept = [c for c in walked.frame if c == "t" or c.startswith(wanted[1:])]
    kept = [c for c in kept if "_des_" not in c and "_ff_" not in c]
    names = {c: in_the_manner_of(manner, c) for c in kept}
    assert len({name for name, _ in names.values()}) == len(kept)
    theirs = pd.DataFrame({name: scale * walked.frame[c] for c, (name, scale) in names.items()})
    shuffled = np.random.default_rng(0).permutation(theirs.columns)
    theirs.iloc[::5][shuffled].to_csv(tmp_path / "run.csv", index=False)
    draft = guess_map([tmp_path / "run.csv"])
    truth: Truth = {}
    for column, (name, scale) in names.items():
        where = f"reference {column}" if column.startswith("ref_") else column
        truth[where] = (name, 1.0 / scale, 0.0)
    truth["reference t"] = truth["t"]
    right, total, silent = judged(draft, truth)
    assert not silent
    assert right >= ENOUGH * total, draft.text
    # The draft is a map that works as it is.
    (tmp_path / "map.toml").write_text(draft.text)
    log = import_log(tmp_path / "run.csv", tmp_path / "map.toml")
    np.testing.assert_allclose(log.q, walked.q[::5], atol=1e-6)
    np.testing.assert_allclose(log.gyro, walked.gyro[::5], atol=1e-6)
    np.testing.assert_allclose(log.ref_p, walked.ref_p[::5], atol=1e-9)


def test_the_outer_legs_go_further_in_turns(walked):
    t, yaw = walked.t, walked.gyro[:, 2]
    q = walked.q.reshape(len(t), 4, 3)[:, :, 1]
    left, right = [q[:, 0], q[:, 2]], [q[:, 1], q[:, 3]]
    further, swapped = stride_in_turns(t, yaw, left, right), stride_in_turns(t, yaw, right, left)
    assert further is not None
    assert swapped is not None
    assert further > 0.1
    assert swapped < -0.1
    assert stride_in_turns(t, 0.0 * yaw, left, right) is None


def test_swapped_legs_a_wrong_gravity_and_a_wrong_rate_are_asked_about(tmp_path, walked):
    wanted = ("t", "gyro_", "accel_", "q_", "dq_")
    kept = [c for c in walked.frame if c == "t" or c.startswith(wanted[1:])]
    frame = walked.frame[[c for c in kept if "_des_" not in c]].iloc[::5]
    other = {"FL": "FR", "FR": "FL", "RL": "RR", "RR": "RL"}
    swap = {c: c.replace(leg, other[leg]) for c in frame for leg in LEGS if f"_{leg}_" in c}

    def doubts(changed: pd.DataFrame) -> dict[str, str]:
        changed.to_csv(tmp_path / "run.csv", index=False)
        return {e.name: e.doubt for e in guess_map([tmp_path / "run.csv"]).main}

    assert not any(doubts(frame).values())
    assert "swapped" in doubts(frame.rename(columns=swap))["q_FL_hip"]
    upside_down = frame.assign(accel_z=-frame["accel_z"], accel_y=-frame["accel_y"])
    assert "upside down" in doubts(upside_down)["accel_z"]
    on_x = frame.rename(columns={"accel_x": "accel_z", "accel_z": "accel_x"})
    assert "gravity reads + on x" in doubts(on_x)["accel_x"]
    rates = [c for c in frame if c.startswith("dq_")]
    assert (
        "times the change" in doubts(frame.assign(**{c: 7.0 * frame[c] for c in rates}))[rates[0]]
    )
    assert "sign = -1" in doubts(frame.assign(**{c: -frame[c] for c in rates}))[rates[0]]


def test_a_text_without_a_header_and_without_names_is_asked_about(tmp_path):
    t = 0.01 * np.arange(200)
    pd.DataFrame({"a": t, "b": np.sin(t)}).to_csv(tmp_path / "run.csv", index=False, header=False)
    draft = guess_map([tmp_path / "run.csv"])
    assert "header = false" in draft.text
    assert [(e.name, e.theirs, bool(e.doubt)) for e in draft.main] == [("t", "0", True)]
    assert "not used: 1" in draft.text


def test_the_command_prints_a_draft_or_writes_it(tmp_path, capsys):
    t = 0.01 * np.arange(200)
    pd.DataFrame({"time": t, "angle_knee": np.sin(t)}).to_csv(tmp_path / "run.csv", index=False)
    main(["import", "--guess", str(tmp_path / "run.csv")])
    assert 'q_knee = { column = "angle_knee", unit = "rad" }' in capsys.readouterr().out
    main(["import", "--guess", str(tmp_path / "run.csv"), "-o", str(tmp_path / "map.toml")])
    assert "0 questions" in capsys.readouterr().out
    out = tmp_path / "log.parquet"
    main(["import", str(tmp_path / "run.csv"), "--map", str(tmp_path / "map.toml"), "-o", str(out)])
    assert Log.read(out).joints == ("knee",)
    frame = pd.DataFrame({"time": t, "q_l_hip_pitch": np.sin(t), "q_r_hip_pitch": np.cos(t)})
    frame.to_csv(tmp_path / "biped.csv", index=False)
    main(["import", "--guess", str(tmp_path / "biped.csv")])
    assert "q_l_hip_pitch = " in capsys.readouterr().out
    for words in (["import", "run.csv"], ["import", "csv"]):
        with pytest.raises(SystemExit, match="surefoot: "):
            main(words)
