"""Drafts of maps: how many of their entries are right, and that no wrong one is without a doubt."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from recorded import check_entries, csv, drafted, entries_of, imported, saved
from written import written

from studies.measured import measured_folder
from surefoot.scenarios.cli.main import main
from surefoot.scenarios.export import export
from surefoot.sim.importing.guessing.draft import Draft
from surefoot.sim.importing.guessing.guess import guess_map
from surefoot.sim.importing.guessing.names import by_their_legs, read_name
from surefoot.sim.importing.guessing.units import stride_in_turns, unit_of_gyro
from surefoot.sim.importing.map import ImportMap
from surefoot.sim.log import LEGS, Log
from surefoot.sim.robot.catalog import robot_file

MEASURED = measured_folder()
Truth = dict[str, tuple[str, float, float]]
"""Their column, scale and offset of each column of the log."""
ENOUGH = 0.9


def truth_of(name: str) -> Truth:
    """What a bundled map says."""
    rules = ImportMap.read(name)
    found = {}
    for columns in (rules.columns, rules.reference_columns):
        for column, one in columns.items():
            key = f"reference {column}" if columns is rules.reference_columns else column
            label = f"{one.source}:" if one.source else ""
            theirs = one.theirs
            for place, joint in enumerate(rules.sections.source.names):
                theirs = theirs.replace(f"[{joint}]", f"[{place}]")
            found[key] = (label + theirs, one.scale, one.offset)
    return found


def same(a: tuple, b: tuple) -> bool:
    """Whether two entries read the same; the place of a single column may be left out."""
    plain = (str(x[0]).removesuffix("[0]") for x in (a, b))
    return len(set(plain)) == 1 and a[1] == pytest.approx(b[1]) and a[2] == pytest.approx(b[2])


def xyzw(log: Log) -> np.ndarray:
    """The reference's attitude (N, 4) with its scalar last."""
    return log.frame[[f"ref_q_{a}" for a in "xyzw"]].to_numpy()


def judged(draft: Draft, truth: Truth) -> tuple[int, int, list[str]]:
    """Entries that are right, entries of the truth, and wrong ones without a doubt."""
    found = {name: (e.theirs, e.scale, 0.0) for name, e in entries_of(draft).items()}
    right = {name for name, one in truth.items() if name in found and same(found[name], one)}
    silent = [name for name, e in entries_of(draft).items() if not e.doubt and name not in right]
    return len(right), len(truth), silent


MEASURED_LOGS = {
    "go1_square": (("imu_joints.csv", "reference_recounted.csv"), truth_of("go1_square")),
    "go2_in_air": (("joints.csv",), truth_of("go2_in_air")),
    "ak80_pendulum": (("pd_measured.csv",), truth_of("ak80_pendulum")),
    "icub_biped": (("walking.mat",), truth_of("icub_biped")),
    "scaler_trot": (
        ("logs/scaler_06.csv", "reference/scaler_06_vicon.csv"),
        truth_of("scaler_trot"),
    ),
}


@pytest.mark.skipif(not MEASURED.is_dir(), reason=f"the measured logs are not here ({MEASURED})")
def test_nine_entries_of_ten_are_right_on_measured_logs(capsys):
    rights, totals, said = 0, 0, []
    for folder, (files, truth) in MEASURED_LOGS.items():
        draft = guess_map([MEASURED / folder / one for one in files])
        if folder == "ak80_pendulum":  # its one joint has no name in the file
            truth = {name.replace("shoulder", "joint"): one for name, one in truth.items()}
        if folder == "scaler_trot":  # contacts that the map does not believe, and a study's forces
            truth = {
                name.removeprefix("x_"): one
                for name, one in truth.items()
                if not name.startswith("x_toe_force")
            }
        right, total, silent = judged(draft, truth)
        extra = [name for name in silent if name not in truth]
        said.append(f"{folder}: {right} of {total} entries right, beyond the map {extra}")
        assert not [name for name in silent if name in truth], said[-1]
        rights, totals = rights + right, totals + total
    with capsys.disabled():
        print("\n".join(["", *said, f"all: {rights} of {totals}, {100 * rights / totals:.1f} %"]))
    assert rights >= ENOUGH * totals


DEGREES = 180.0 / np.pi
IN_G = 1.0 / 9.80665
MANNERS: dict[str, dict[str, str | tuple[str, float]]] = {
    "short": {"t": "time", "gyro": "w{a}", "accel": "a{a}", "q": "q_{leg}_{part}"}
    | {"dq": "dq_{leg}_{part}", "tau": "tau_{leg}_{part}", "contact": "CONTACT_{leg}"}
    | {"ref_p": "p{a}", "ref_q": "q{a}"},
    "ros": {"t": ("stamp_ns", 1e9), "gyro": "imu.angular_velocity.{a}"}
    | {"accel": "imu.linear_acceleration.{a}", "q": "joint_states.position.{LF}_{HAA}"}
    | {"dq": "joint_states.velocity.{LF}_{HAA}", "tau": "joint_states.effort.{LF}_{HAA}"}
    | {"contact": "contacts.{LF}", "ref_p": "mocap.pose.position.{a}"}
    | {"ref_q": "mocap.pose.orientation.{a}"},
    "words": {
        "t": "Time [s]",
        "gyro": ("Gyro {A} [deg/s]", DEGREES),
        "accel": ("Acc {A} [g]", IN_G),
    }
    | {"q": ("Front Left {part} Angle [deg]", DEGREES), "tau": "Front Left {part} Torque [Nm]"}
    | {"dq": ("Front Left {part} Speed [deg/s]", DEGREES), "contact": "Front Left Contact"}
    | {"ref_p": ("Mocap Position {A} [mm]", 1e3), "ref_q": "Mocap Quaternion {A}"},
    "capitals": {"t": "timeSec", "gyro": "gyro{A}", "accel": "acc{A}", "q": "FrontLeft{Part}Pos"}
    | {"dq": "FrontLeft{Part}Vel", "tau": "FrontLeft{Part}Torque", "contact": "FrontLeftContact"}
    | {"ref_p": "mocapPos{A}", "ref_q": "mocapQuat{A}"},
    "right first": {"t": ("lcm_timestamp", 1e6), "gyro": "omegaBody[{n}]", "accel": "aBody[{n}]"}
    | {"q": "q[{mit}]", "dq": "qd[{mit}]", "tau": "tauEst[{mit}]", "contact": "contact[{foot}]"}
    | {"ref_p": "mocap_position[{n}]", "ref_q": "mocap_orientation[{n}]"},
    "from one": {"t": "t", "gyro": ("gyr_{a}", DEGREES), "accel": "acc_{a}"}
    | {"q": "leg{l}_joint{j}_q"}
    | {"dq": "leg{l}_joint{j}_dq", "tau": "leg{l}_joint{j}_tau", "contact": "contact{l}"}
    | {"ref_p": "pos_ref_{a}", "ref_q": "quat_ref_{a}"},
}
"""How others name the columns of a log, and what they multiply its values by where they do."""
ANYMAL = {"FL": "LF", "FR": "RF", "RL": "LH", "RR": "RH"}
RIGHT_FIRST = ["FR", "FL", "RR", "RL"]
HINGES = {"hip": "HAA", "thigh": "HFE", "calf": "KFE"}


def in_the_manner_of(manner: str, name: str) -> tuple[str, float]:
    """Another's name for a column of the log, and what its values are multiplied by."""
    kind = next(k for k in MANNERS[manner] if name == k or name.startswith(f"{k}_"))
    said = MANNERS[manner][kind]
    text, scale = said if isinstance(said, tuple) else (said, 1.0)
    rest = name.removeprefix(kind).strip("_")
    leg, _, part = rest.partition("_")
    if leg not in LEGS:
        return text.format(a=leg, A=leg.upper(), n="wxyz".find(leg) - (kind != "ref_q")), scale
    end, side = ("Front", "Rear")[leg[0] == "R"], ("Left", "Right")[leg[1] == "R"]
    text = text.replace("Front", end).replace("Left", side)
    place = ["hip", "thigh", "calf"].index(part) if part else 0
    number, foot = LEGS.index(leg), RIGHT_FIRST.index(leg)
    words = {"leg": leg, "LF": ANYMAL[leg], "part": part, "Part": part.title()}
    words |= {"HAA": HINGES.get(part)}
    counts = {"i": 3 * number + place, "mit": 3 * foot + place, "foot": foot}
    counts |= {"l": number + 1, "j": place + 1}
    return text.format(**words, **counts), scale


@pytest.mark.parametrize("manner", MANNERS)
def test_a_simulated_log_with_columns_renamed_and_shuffled_is_drafted(tmp_path, log, manner):
    wanted = "^(t$|gyro_|accel_|d?q_(?!des)|tau_(?!ff)|contact_|ref_[pq]_)"
    kept = [*log.frame.filter(regex=wanted)]
    names = {c: in_the_manner_of(manner, c) for c in kept}
    assert len({name for name, _ in names.values()}) == len(kept)
    theirs = pd.DataFrame({name: scale * log.frame[c] for c, (name, scale) in names.items()})
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
    back = imported(tmp_path / "run.csv", draft)
    np.testing.assert_allclose(back.q, log.q[::5], atol=1e-6)
    np.testing.assert_allclose(back.gyro, log.gyro[::5], atol=1e-6)
    np.testing.assert_allclose(back.ref_p, log.ref_p[::5], atol=1e-9)


VORNE_HINTEN = {"FL": "vl", "FR": "vr", "RL": "hl", "RR": "hr"}
"""Legs in German, of which two are words for other legs in English."""


def test_columns_are_known_by_the_robots_own_words_for_legs_and_joints(tmp_path, log):
    parts = {"hip": "roll", "thigh": "swing", "calf": "fold"}
    theirs = {j: f"{VORNE_HINTEN[j[:2]]}_{parts[j[3:]]}" for j in log.joints}
    model = robot_file("spot_class").read_text()
    for joint, name in theirs.items():
        model = model.replace(f'"{joint}"', f'"wz_{name}"')
    (tmp_path / "mine.xml").write_text(model)
    rows = log.frame[::5]
    columns = {"time": rows["t"]}
    columns |= {f"winkel_{name}_deg": DEGREES * rows[f"q_{j}"] for j, name in theirs.items()}
    columns |= {f"moment_{name}": rows[f"tau_{j}"] for j, name in theirs.items()}
    forces = {f"foot_force_{VORNE_HINTEN[leg]}": rows[f"force_{leg}"] for leg in LEGS}
    poses = {f"marker_{a}_mm": 1e3 * rows[f"ref_p_{a}"] for a in "xyz"}
    poses |= {f"rot_q{a}": rows[f"ref_q_{a}"] for a in "xyzw"}
    mocap = csv(tmp_path, {"time": rows["t"]} | poses, "mocap.csv")
    draft = guess_map([csv(tmp_path, columns | forces), mocap], str(tmp_path / "mine.xml"))
    check_entries(
        draft,
        {f"q_{j}": (f"winkel_{name}_deg", "deg") for j, name in theirs.items()}
        | {f"tau_{j}": (f"moment_{name}", "N m") for j, name in theirs.items()}
        | {f"force_{leg}": (f"foot_force_{VORNE_HINTEN[leg]}",) for leg in LEGS}
        | {"reference ref_p_x": ("marker_x_mm", "mm"), "reference ref_q_w": ("rot_qw", None)},
    )
    assert not [note for note in draft.notes if "force" in note]


def test_feet_without_a_column_beside_others_are_asked_about(tmp_path):
    t = 0.01 * np.arange(200)
    forces = {f"foot_force_{leg}": 50.0 + np.sin(t) for leg in VORNE_HINTEN.values()}
    draft = guess_map([csv(tmp_path, {"time": t} | forces)])
    asked = [note for note in draft.notes if note.startswith("force of RL, RR alone")]
    assert ["foot_force_vl" in one and "foot_force_vr" in one for one in asked] == [True]
    # By a robot of four legs, one that has no column at all is missed.
    three = {f"foot_force_{leg}": 50.0 + np.sin(t) for leg in ("FL", "FR", "RL")}
    draft = guess_map([csv(tmp_path, {"time": t} | three, "three.csv")], "spot_class")
    assert [note for note in draft.notes if note.startswith("force of FL, FR, RL alone")]


def test_the_joints_of_an_arm_are_those_of_its_file(tmp_path):
    """Words of their own names, such as "rotation" and "lift", say nothing about a column."""
    joints = ["torso_lift_joint", "arm_1_joint", "wrist_rotation_joint"]
    hinge = '<body><joint name="{}" axis="0 1 0"/><geom size=".1"/>'
    bodies = "".join(hinge.format(joint) for joint in joints) + 3 * "</body>"
    arm = written(tmp_path / "arm.xml", f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    t = 0.01 * np.arange(1000)
    files = []
    for kind, wave in (("position", np.sin), ("velocity", np.cos), ("effort", np.cos)):
        columns = {f"- {joint}_{kind}": wave(t + k) for k, joint in enumerate(joints)}
        files.append(csv(tmp_path, {"t": t} | columns, f"{kind}.csv"))
    found = entries_of(guess_map(files, str(arm)))
    label = {"position": "", "velocity": "velocity:", "effort": "effort:"}
    assert {name: one.theirs for name, one in found.items()} == {"t": "t"} | {
        f"{ours}_{joint}": f"{label[kind]}- {joint}_{kind}"
        for ours, kind in (("q", "position"), ("dq", "velocity"), ("tau", "effort"))
        for joint in joints
    }


def test_what_slides_has_units_of_distance_speed_and_force(tmp_path):
    bodies = '<body><joint name="rail" type="slide" axis="1 0 0"/><geom size=".1"/>'
    bodies += '<body><joint name="boom" axis="0 1 0"/><geom size=".1"/></body></body>'
    crane = written(tmp_path / "crane.xml", f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    t = 0.004 * np.arange(2000)
    run = {"t": t, "boom_pos": np.sin(t), "boom_vel": np.cos(t), "boom_effort": np.cos(t)}
    run |= {"rail_pos": 300.0 * np.sin(t), "rail_vel": 0.3 * np.cos(t), "rail_effort": np.cos(t)}
    found = entries_of(guess_map([csv(tmp_path, run)], str(crane)))
    assert {name: one.unit for name, one in found.items()} == {
        **{"t": "s", "q_boom": "rad", "dq_boom": "rad/s", "tau_boom": "N m"},
        **{"q_rail": "mm", "dq_rail": "m/s", "tau_rail": "N"},
    }


def test_a_file_of_which_nothing_is_used_is_asked_about(tmp_path):
    t = 0.01 * np.arange(200)
    run = csv(tmp_path, {"time": t, "angle_knee": np.sin(t)})
    more = csv(tmp_path, {"when": t, "what": np.cos(t)}, "more.csv")
    assert guess_map([run, more]).notes == (
        "nothing of more.csv is used: what are its columns when, what?",
    )


def test_names_that_say_nothing_are_asked_about_and_give_no_log(tmp_path):
    t = 0.01 * np.arange(200)
    draft = drafted(tmp_path, {"time": t, "channel 1": np.sin(t), "channel 2": np.cos(t)})
    assert draft.notes == ("no name says what a column is: which of those not used below is what?",)
    map_path, out = written(tmp_path / "map.toml", draft.text), tmp_path / "log.parquet"
    with pytest.raises(SystemExit, match="names no column but the times"):
        main(["import", str(tmp_path / "run.csv"), "--map", str(map_path), "-o", str(out)])
    assert not out.exists()


def test_questions_that_are_still_open_are_counted_at_import(tmp_path, capsys):
    t = 0.01 * np.arange(200)
    draft = drafted(tmp_path, {"time": t, "q1": np.sin(t), "q2": np.cos(t)}).text
    answered = "\n".join(line for line in draft.splitlines() if "# ? " not in line)
    for text, is_open in ((draft, True), (answered, False)):
        map_path = written(tmp_path / "map.toml", text)
        run, out = str(tmp_path / "run.csv"), str(tmp_path / "log.parquet")
        main(["import", run, "--map", str(map_path), "-o", out, "--force"])
        said = "map.toml: 1 question (# ?) in it still; its guesses were used\n"
        assert capsys.readouterr().out.endswith(said) == is_open


@pytest.mark.parametrize(("most", "unit"), [(11.8, "rad/s"), (12.4, "deg/s")])
def test_without_an_accelerometer_a_gyro_s_unit_is_told_by_its_size(most, unit):
    """No walking robot turns by 12 rad/s, which are two turns a second."""
    assert unit_of_gyro(None, np.full((99, 3), most), None, set())[0] == unit


def test_what_export_writes_is_drafted_and_comes_back(tmp_path, log):
    start = replace(log, frame=log.frame[:1000])
    start.write(tmp_path / "log.parquet")
    for ending in ("mcap", "csv"):
        out = tmp_path / f"out.{ending}"
        export(tmp_path / "log.parquet", out)
        draft = guess_map([out])
        assert not [e.name for e in (*draft.main, *draft.reference) if e.doubt]
        back = imported(out, draft)
        for stream in ("gyro", "accel", "q", "dq", "tau", "contact", "ref_p"):
            np.testing.assert_allclose(getattr(back, stream), getattr(start, stream), atol=1e-6)


def test_the_outer_legs_go_further_in_turns(log):
    t, yaw = log.t, log.gyro[:, 2]
    q = log.q.reshape(len(t), 4, 3)[:, :, 1]
    left, right = [q[:, 0], q[:, 2]], [q[:, 1], q[:, 3]]
    further, swapped = (stride_in_turns(t, yaw, *q) or 0.0 for q in ((left, right), (right, left)))
    assert further == pytest.approx(-swapped)
    assert further > 0.1
    assert stride_in_turns(t, 0.0 * yaw, left, right) is None
    # A stamp that jumps by 30 000 years makes no array of as many seconds.
    jumps = np.append(t[:-1], 1e12)
    assert stride_in_turns(jumps, yaw, left, right) == pytest.approx(further, rel=0.01)


def test_swapped_legs_a_wrong_gravity_and_a_wrong_rate_are_asked_about(tmp_path, log):
    frame = log.frame.filter(regex="^(t$|gyro_|accel_|d?q_(?!des))").iloc[::5]
    other = {"FL": "FR", "FR": "FL", "RL": "RR", "RR": "RL"}
    swap = {c: c.replace(leg, other[leg]) for c in frame for leg in LEGS if f"_{leg}_" in c}

    assert not any(one.doubt for one in drafted(tmp_path, frame).main)
    turned = {c: -frame[c] for c in ("accel_y", "accel_z")}
    rates = {c: frame[c] for c in map(str, frame) if c.startswith("dq_")}
    other_axis = {"accel_x": "accel_z", "accel_z": "accel_x"}
    for changed, entry, doubt in (
        (frame.rename(columns=swap), "q_FL_hip", "swapped"),
        (frame.assign(**turned), "accel_z", "gravity reads - on z"),
        (frame.rename(columns=other_axis), "accel_x", "gravity reads + on x"),
        (frame.assign(**{c: 7.0 * x for c, x in rates.items()}), "dq_FL_hip", "times the change"),
        (frame.assign(**{c: -x for c, x in rates.items()}), "dq_FL_hip", "sign = -1"),
    ):
        assert doubt in entries_of(drafted(tmp_path, changed))[entry].doubt


def test_a_draft_names_the_robots_file_from_its_own_folder(tmp_path, monkeypatch, capsys):
    t = 0.01 * np.arange(200)
    for place in ("maps", "bot", "run"):
        (tmp_path / place).mkdir()
    csv(tmp_path / "run", {"time": t, "q_FL_hip": np.sin(t)})
    (tmp_path / "bot" / "mine.xml").write_text(robot_file("spot_class").read_text())
    monkeypatch.chdir(tmp_path)
    ask = ["import", "--guess", "run/run.csv", "--robot", "bot/mine.xml"]
    main([*ask, "-o", "maps/map.toml"])
    assert ImportMap.read("maps/map.toml").robot == "../bot/mine.xml"
    capsys.readouterr()
    main(ask)  # wherever the text will be saved
    assert f'name = "{(tmp_path / "bot" / "mine.xml").as_posix()}"' in capsys.readouterr().out


def test_cells_that_are_empty_between_readings_are_drafted(tmp_path, log):
    """As PlotJuggler writes topics into one table: a row for each stamp of any of them."""
    topics = {
        "/imu/data/angular_velocity/{}": (log.gyro, "xyz", 1, 3e-4),
        "/imu/data/linear_acceleration/{}": (log.accel, "xyz", 1, 3e-4),
        "/joint_states/{}_joint/position": (log.q, log.joints, 2, 0.0),
        "/mocap/pose/position/{}": (log.ref_p, "xyz", 5, 1e-4),
        "/mocap/pose/orientation/{}": (xyzw(log), "xyzw", 5, 1e-4),
    }
    read = [
        pd.DataFrame(
            values[::every],
            index=pd.Index(np.round(1.7e9 + log.t[::every] + delay, 6), name="__time"),
            columns=[name.format(one) for one in names],
        )
        for name, (values, names, every, delay) in topics.items()
    ]
    path = tmp_path / "topics.csv"
    pd.concat(read, axis=1).sort_index().to_csv(path)
    draft = guess_map([path])
    assert not [e.name for e in (*draft.main, *draft.reference) if e.doubt]
    back = imported(path, draft)
    assert back.rate == pytest.approx(log.rate, rel=1e-3)
    first = round((back.t[0] - log.t[0]) * log.rate)
    rows = first + np.arange(len(back.t))
    assert len(rows) > 0.99 * len(log.t)
    for stream, close in (("gyro", 1e-9), ("q", 0.02), ("ref_p", 1e-3)):
        np.testing.assert_allclose(getattr(back, stream), getattr(log, stream)[rows], atol=close)


@pytest.mark.parametrize("body", ["", "go_back_", "RigidBody1."])
def test_axes_without_a_word_are_the_position_of_the_body_whose_quaternion_is_beside(
    tmp_path, log, body
):
    poses = {"Frame": np.arange(len(log.t)), "Time (Seconds)": log.t}
    poses |= {f"{body}{a.upper()}": 1e3 * log.ref_p[:, i] for i, a in enumerate("xyz")}
    poses |= {f"{body}Q{a.upper()}": log.ref_q[:, i] for i, a in enumerate("wxyz")}
    log.frame.filter(regex="^(t|gyro_.|accel_.|q_.*)$").to_csv(tmp_path / "robot.csv", index=False)
    draft = guess_map([tmp_path / "robot.csv", csv(tmp_path, poses, "mocap.csv")])
    assert {(e.name, e.theirs) for e in draft.reference} == {
        ("t", "Time (Seconds)"),
        *((f"ref_p_{a}", f"{body}{a.upper()}") for a in "xyz"),
        *((f"ref_q_{a}", f"{body}Q{a.upper()}") for a in "wxyz"),
    }


def test_groups_of_a_file_that_have_clocks_of_their_own_are_all_drafted(tmp_path, log):
    """An HDF5 with nanoseconds since 1970 in each group: IMU at 250 Hz, the rest slower."""
    groups = {
        "sensors/imu0": (2, {"angular_velocity": (DEGREES * log.gyro), "acc": log.accel}),
        "actuators": (5, {"position": log.q, "velocity": log.dq, "torque": log.tau}),
        "mocap/dog": (4, {"position_mm": 1e3 * log.ref_p, "quat_xyzw": xyzw(log)}),
    }
    datasets = {}
    for name, (every, arrays) in groups.items():
        arrays["stamp_ns"] = np.round(1e9 * (1.7e9 + log.t)).astype(np.int64)
        datasets |= {f"{name}/{array}": values[::every] for array, values in arrays.items()}
    draft = guess_map([saved(tmp_path / "run.h5", datasets)])
    assert {e.name for e in draft.main if e.doubt} == {
        *(f"gyro_{a}" for a in "xyz"),
        *(f"{kind}_{joint}" for kind in ("q", "dq", "tau") for joint in log.joints),
    }
    assert not [e.name for e in draft.reference if e.doubt]
    back = imported(tmp_path / "run.h5", draft)
    assert back.rate == pytest.approx(250.0, rel=1e-4)
    rows = 2 * np.arange(len(back.t))  # all begin at the same time
    assert len(rows) > 3000
    for stream, close in (("gyro", 1e-9), ("q", 0.02), ("ref_p", 1e-3)):
        np.testing.assert_allclose(getattr(back, stream), getattr(log, stream)[rows], atol=close)


@pytest.mark.parametrize(
    "theirs",
    [
        "abduct hip knee",
        "hip thigh calf",
        "haa hfe kfe",
        "hx hy kn",
        "hip_roll hip_pitch knee_pitch",
    ],
)
def test_a_hip_beside_an_abduction_is_our_thigh(theirs):
    found = by_their_legs({f"q_FL_{part}": read_name(f"q_FL_{part}") for part in theirs.split()})
    assert [one.part for one in found.values()] == ["hip", "thigh", "calf"]


def test_a_contacts_thresholds_lie_between_no_load_and_all(tmp_path):
    """Of what a foot bears when all stand, it is told at half, and lost at two fifths: feet at rest
    stand, though in a walk with three feet down they bear more."""
    t = 0.01 * np.arange(400)
    down = np.stack([np.mod(t + k / 4, 1.0) < 0.75 for k in range(4)])
    loads = np.where(t < 1.0, 100.0, 400.0 * down / down.sum(axis=0))
    feet = {f"foot_force_{leg}": 10.0 + one for leg, one in zip(LEGS, loads, strict=True)}
    assert drafted(tmp_path, {"t": t} | feet).contact == pytest.approx((60.0, 50.0))


def test_contacts_of_six_legs_are_known_by_the_words_of_their_joints(tmp_path):
    """Legs of other than four or two are named after their first body."""
    legs = {
        f"{side}{k}": (0.1 * (2 - k), y) for side, y in (("l", 1), ("r", -1)) for k in (1, 2, 3)
    }
    bodies = "".join(
        f"""<body name="coxa_{leg}" pos="{x} {0.1 * y} 0"><joint name="coxa_{leg}" axis="0 0 1"/>
        <geom size="0.01" contype="0" conaffinity="0"/>
        <body pos="0 {0.1 * y} 0"><joint name="tibia_{leg}" axis="1 0 0"/>
        <geom size="0.01" pos="0 0 -0.1"/></body></body>"""
        for leg, (x, y) in legs.items()
    )
    base = '<freejoint/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
    text = f'<mujoco><worldbody><body name="base">{base}{bodies}</body></worldbody></mujoco>'
    robot = written(tmp_path / "hexapod.xml", text)
    t = np.arange(0.0, 2.0, 0.01)
    columns = {"time": t} | {f"acc_{a}": np.sin(t) + 9.81 * (a == "z") for a in "xyz"}
    columns |= {f"pos_{part}_{leg}": np.sin(3 * t) for leg in legs for part in ("coxa", "tibia")}
    columns |= {f"contact_{leg}": (np.sin(t) > 0).astype(int) for leg in legs}
    draft = guess_map([csv(tmp_path, columns)], str(robot))
    check_entries(draft, {f"contact_coxa_{leg}": (f"contact_{leg}",) for leg in legs})
