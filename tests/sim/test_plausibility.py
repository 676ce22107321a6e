"""One short walk, made nonsense in many ways: each is noticed, by the right rule and name."""

import re
import sys
import tomllib
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
import pytest
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation
from synthetic import without

from surefoot.sim.common.series import low_pass
from surefoot.sim.gait.options import GaitOptions
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.importing.reference_check import contradicted
from surefoot.sim.log import LEGS, Log, Meta
from surefoot.sim.log.reference import Poses
from surefoot.sim.log.schema import GROUPS
from surefoot.sim.plausibility import RULES, check_log, rules_table
from surefoot.sim.plausibility.finding import PARAGRAPHS, Finding, Rule
from surefoot.sim.plausibility.streams import _drop_outs
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.scenario_catalog import bundled_scenarios, scenario_file
from surefoot.sim.walk import walk

SPOT = Robot.load("spot_class")
COURSE = (Segment(2.5, 0.7), Segment(3.0, 0.5, turn=0.6), Segment(2.5, 0.7, turn=-0.4))
GYRO, ACCEL = ([f"{kind}_{a}" for a in "xyz"] for kind in ("gyro", "accel"))
DEGREE = 180.0 / np.pi
G = 9.80665
NED = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))
JOINTS = "(q|dq|tau)_"
"""Columns of joints, without their commands."""


@pytest.fixture(scope="module")
def ahead() -> Log:
    return walk(Scenario("straight", (Segment(5.0, 0.7),), Ground(0.8)), SPOT, 5)


@pytest.fixture(scope="module")
def log() -> Log:
    return walk(Scenario("plain", COURSE, Ground(0.8)), SPOT, 5)


def found_in(log: Log, robot: Robot | None = SPOT) -> list[str]:
    return [f"{one.rule}: {one.line}" for one in check_log(log, robot)]


def named(start: str, log: Log, robot: Robot | None = SPOT) -> bool:
    """Whether a finding of this rule and of these streams is there."""
    return any(line.startswith(start) for line in found_in(log, robot))


# What is done to the columns of a log whose names begin with a pattern, each (N,).

Values = Callable[[np.ndarray], np.ndarray]


def changed(log: Log, pattern: str, change: Values) -> Log:
    names = columns_of(log, pattern)
    return log.with_columns({name: change(log.frame[name].to_numpy()) for name in names})


def columns_of(log: Log, pattern: str) -> list[str]:
    named = [name for name in map(str, log.frame) if re.match(pattern, name)]
    found = [n for n in named if not n.startswith(("q_des", "dq_des", "tau_ff"))]
    assert found
    return found


def times(factor: float) -> Values:
    return lambda x: factor * x


def plus(amount: float) -> Values:
    return lambda x: x + amount


def frozen(x: np.ndarray) -> np.ndarray:
    rows = np.arange(len(x))
    return np.where((rows >= len(x) // 3) & (rows <= len(x) // 2), x[len(x) // 3], x)


def clipped(x: np.ndarray) -> np.ndarray:
    return np.clip(x, *np.quantile(x, (0.1, 0.9)))


def leaping(size: float) -> Values:
    return lambda x: x + size * (np.arange(len(x)) % 500 == 100)


def zeroed(x: np.ndarray) -> np.ndarray:
    return np.where(np.arange(len(x)) % 200 == 50, 0.0, x)


def disconnected(x: np.ndarray) -> np.ndarray:
    rows = np.arange(len(x))
    return np.where((rows >= 2000) & (rows <= 2150), 0.0, x)


def straight(every: int) -> Values:
    """On straight lines between each so many rows."""
    return lambda x: np.interp(np.arange(len(x)), np.arange(len(x))[::every], x[::every])


def noisy(size: float) -> Values:
    rng = np.random.default_rng(0)
    return lambda x: x + rng.normal(0.0, size, len(x))


def rounded(step: float) -> Values:
    return lambda x: step * np.round(x / step)


def held(x: np.ndarray) -> np.ndarray:
    return x[np.arange(len(x)) // 4 * 4]


def every_second_step(contact: np.ndarray) -> np.ndarray:
    step = np.cumsum(np.diff(contact, prepend=contact[0]) > 0.0)
    return np.where(step % 2 == 1, 0.0, contact)


# What is done to several columns together, or to the rows.


def exchanged(*pairs: tuple[str, str]) -> Callable[[Log], Log]:
    """Exchange columns, whole families of them by a part of their name."""

    def change(log: Log) -> Log:
        values = {}
        for a, b in pairs:
            for c in map(str, log.frame):
                if a in c and not c.startswith(("slip", "mu")):
                    other = c.replace(a, b)
                    values |= {c: log.frame[other], other: log.frame[c]}
        assert values
        return log.with_columns(values)

    return change


def vectors(log: Log, **made: np.ndarray) -> Log:
    return log.with_columns(
        {f"{n}_{a}": x[:, i] for n, x in made.items() for i, a in enumerate("xyz")}
    )


def turned(axis: str, degrees: float) -> Rotation:
    return Rotation.from_euler(axis, degrees, degrees=True)


def imu_turned(log: Log, R: Rotation) -> Log:
    return vectors(log, gyro=R.apply(log.gyro), accel=R.apply(log.accel))


def positions_turned(log: Log, R: Rotation) -> Log:
    return vectors(log, ref_p=R.apply(log.ref_p), ref_v=R.apply(log.ref_v))


def attitude(log: Log, read: Callable[[Rotation], Rotation]) -> Log:
    q = read(Rotation.from_quat(log.ref_q, scalar_first=True)).as_quat(scalar_first=True)
    return log.with_columns({f"ref_q_{a}": q[:, i] for i, a in enumerate("wxyz")})


def body_turned(log: Log, R: Rotation) -> Log:
    return attitude(log, lambda attitudes: attitudes * R)


def in_world(log: Log, R_WG: Rotation) -> Log:
    return attitude(positions_turned(log, R_WG), lambda R: R_WG * R)


def euler_angles(log: Log, read: Callable[..., tuple[np.ndarray, ...]]) -> Log:
    """Attitudes with other Euler angles, given yaw, pitch and roll."""
    return attitude(
        log, lambda R: Rotation.from_euler("ZYX", np.column_stack(read(*R.as_euler("ZYX").T)))
    )


def leg_odometry(log: Log) -> Log:
    """The reference's positions as legs and gyro have them."""
    feet, on = SPOT.feet_I(log.q), log.contact[:, :, None]
    by_leg = -(np.gradient(feet, log.t, axis=0) + np.cross(log.gyro[:, None], feet))
    v_I = np.sum(by_leg * on, axis=1) / np.maximum(on.sum(axis=1), 1)
    v_GI = np.einsum("nij,nj->ni", log.ref_R_GI, v_I)
    return vectors(log, ref_p=log.ref_p[0] + np.cumsum(v_GI, axis=0) / log.rate, ref_v=v_GI)


def velocity_in_body(log: Log) -> Log:
    return vectors(log, ref_v=np.einsum("nji,nj->ni", log.ref_R_GI, log.ref_v))


def sinking(log: Log) -> Log:
    down = np.array([0.0, 0.0, -0.3])
    return vectors(log, ref_p=log.ref_p + log.t[:, None] * down, ref_v=log.ref_v + down)


def differenced(log: Log, pattern: str) -> Log:
    names = columns_of(log, pattern)
    return log.with_columns({c: np.gradient(log.frame[c[1:]], log.t) for c in names})


def lagging(log: Log, seconds: float, pattern: str) -> Log:
    rows, names = round(seconds * log.rate), columns_of(log, pattern)
    frame = log.frame.iloc[rows:].reset_index(drop=True)
    frame[names] = log.frame[names].iloc[: len(frame)].to_numpy()
    return replace(log, frame=frame)


def dropped(log: Log, rows: slice | int, restamped: bool = False) -> Log:
    kept = np.ones(len(log.t), dtype=bool)
    kept[rows if isinstance(rows, slice) else slice(7, None, rows)] = False
    found = log.rows(kept)
    return found.with_columns({"t": np.arange(len(found.t)) / log.rate}) if restamped else found


def reordered(log: Log, rows: np.ndarray) -> Log:
    return log.rows(rows).with_columns({"t": log.t[: len(rows)]})


def in_twos_the_wrong_way_about(log: Log) -> Log:
    return reordered(log, np.arange(len(log.t) // 2 * 2).reshape(-1, 2)[:, ::-1].ravel())


def stretched(log: Log, factor: float) -> Log:
    """Time at another speed, or in another unit, in stamps and rate."""
    meta = replace(log.meta, rate=log.meta.rate / factor)
    return replace(log.with_columns({"t": factor * log.t}), meta=meta)


def noisy_contacts(log: Log) -> Log:
    wrong = np.random.default_rng(0).random(log.contact.shape) < 0.1
    both = (log.contact ^ wrong).astype(float)
    return log.with_columns({f"contact_{leg}": both[:, i] for i, leg in enumerate(log.legs)})


def bouncing(log: Log) -> Log:
    """Each landing and lift is followed by eight short changes, as on ice."""
    at = np.flatnonzero(np.diff(log.contact.astype(int), axis=0).any(axis=1))
    contact = log.contact.copy()
    for row in at[at < len(contact) - 20]:
        moved = contact[row] != contact[row + 1]
        contact[row + 2 : row + 17 : 4, moved] = log.contact[row, moved]
    return log.with_columns({f"contact_{x}": contact[:, i] for i, x in enumerate(log.legs)})


def at_rate(log: Log, rate: float) -> Log:
    """Rows of a lower rate, over which the IMU is averaged."""
    n = round(log.rate / rate)
    rows = np.arange(n, len(log.t), n)
    summed = np.cumsum(np.column_stack([log.gyro, log.accel]), axis=0)
    averaged = (summed[rows] - summed[rows - n]) / n
    slow = log.rows(rows).with_columns(dict(zip([*GYRO, *ACCEL], averaged.T, strict=True)))
    return replace(slow, meta=replace(log.meta, rate=log.meta.rate / n))


COLUMN_CASES: dict[str, tuple[str, Values, str, str]] = {
    # the columns, what is done to each; the rule that notices it; what its line says, in part
    "gyro all zero": ("gyro", np.zeros_like, "frozen", "gyro_x, gyro_y, gyro_z"),
    "gyro with z of the wrong sign": ("gyro_z", np.negative, "gyro", "gyro_z: wrong sign"),
    "gyro scaled": ("gyro", times(1.4), "gyro", "1.4 times as fast"),
    "a weak axis": ("gyro_z", times(0.3), "gyro", "gyro_z: scaled"),
    "gyro that drifts": (
        "gyro_z", lambda x: x + np.linspace(0.0, 0.6, len(x)), "gyro", "rad/s off"),
    "gyro saturated": ("gyro_x", clipped, "saturated", "gyro_x"),
    "gyro held": ("gyro", held, "held", "gyro_x"),
    "gyro rounded": ("gyro", rounded(0.1), "coarse", "readings are 0.1 apart"),
    "gyro that is noise": ("gyro", noisy(0.5), "noise", "gyro_x, gyro_y, gyro_z"),
    "gyro that overflows": (
        "gyro_x", lambda x: (20.0 * x + 4.0) % 8.0 - 4.0, "overflow", "gyro_x: numbers that"),
    "an axis frozen": ("gyro_y", frozen, "frozen", "gyro_y: a sensor that hangs"),
    "spikes in the gyro": ("gyro_x", leaping(20.0), "spikes", "gyro_x"),
    "accelerometer in mg": ("accel", times(1e3 / G), "gravity", 'unit = "mg"'),
    "accelerometer in mm/s^2": ("accel", times(1e3), "gravity", "in mm/s^2"),
    "gyro biased": ("gyro_z", plus(0.8), "gyro", "gyro_z: a bias"),
    "accelerometer biased": ("accel_x", plus(1.0), "accelerometer", "accel_x: a bias"),
    "accelerometer in m/s^2, taken for g": ("accel", times(G), "gravity", "gravity twice"),
    "accelerometer scaled": ("accel", times(1.2), "gravity", "scaled by 1.2"),
    "gravity of the wrong sign": ("accel_z", plus(-19.62), "gravity", "offset = 19.62"),
    "accelerometer that is noise": ("accel", noisy(4.0), "noise", "accel_x, accel_y, accel_z"),
    "accelerometer dropped to zero": ("accel", zeroed, "spikes", "drop-outs"),
    "angles in deg": ("q_", times(DEGREE), "joints' unit", 'unit = "deg"'),
    "rates in deg/s": ("dq_", times(DEGREE), "joint rates", 'unit = "deg/s"'),
    "a rate of the wrong sign": (
        "dq_FL_calf", np.negative, "joint rates", "dq_FL_calf: wrong sign"),
    "an angle whose sign changes": (
        "q_FR_thigh", lambda x: np.where(np.arange(len(x)) > 2500, -x, x),
        "joint rates", "dq_FR_thigh: its sign, or that of its angle, changes during the log"),
    "a rate that is noise": ("dq_FL_calf", noisy(3.0), "noise", "dq_FL_calf"),
    "rates all zero": ("dq_", np.zeros_like, "frozen", "dq_FL_hip"),
    "a joint frozen": ("q_FL_calf", frozen, "frozen", "q_FL_calf"),
    "an angle within a turn": (
        "q_FL_calf", lambda x: (x - np.median(x)) % (2.0 * np.pi), "overflow", "wrap = 6.28"),
    "a leg disconnected for a while": (
        f"{JOINTS}RL", disconnected, "spikes", "q_RL_hip, q_RL_thigh, q_RL_calf"),
    "joints between a few readings": (
        "(q|dq)_", straight(5), "interpolated", "readings at 100 Hz"),
    "right hips mirrored": (
        f"{JOINTS}.R_hip", np.negative, "legs", "q_FR_hip, q_RR_hip: wrong sign"),
    "a hip's wrong zero": ("q_RL_hip", plus(0.2), "zeros", "q_RL_hip, q_RR_hip"),
    "a wrong zero": ("q_FL_thigh", plus(0.4), "zeros", "q_FL_thigh, q_FR_thigh"),
    "all calves from another zero": ("q_.._calf", plus(0.3), "legs", "-0.3 rad added"),
    "torques in mN m": ("tau_", times(1e3), "torque", 'unit = "mN m"'),
    "torques negated": ("tau_", np.negative, "torques of legs", "wrong sign"),
    "a torque of the wrong sign": (
        "tau_RL_thigh", np.negative, "torques of legs", "tau_RL_thigh: wrong sign"),
    "torques of the motor": ("tau_", times(1 / 8), "torques of legs", "of the motor's side"),
    "torques without a sign": ("tau_", np.abs, "magnitudes", "without their sign"),
    "a contact stuck for a while": ("contact_RR", frozen, "contacts", "contact_RR"),
    "a contact that misses steps": (
        "contact_FR", every_second_step, "contacts", "contact_FR: a threshold that lighter steps"),
    "positions with z down": (
        "ref_[pv]_z", np.negative, "accelerometer", "ref_p_z: wrong sign"),
    "reference at 5 Hz": ("ref_p", straight(100), "interpolated", "ref_p_x"),
    "reference frozen": ("ref_", frozen, "frozen", "ref_p_x to ref_v_z"),
    "reference scaled": (
        "ref_[pv]", times(1.2), "reference's motion", "times that of the accelerometer"),
    "velocities in mm/s": ("ref_v", times(1e3), "reference's velocity", 'unit = "mm/s"'),
    "velocities of the wrong sign": (
        "ref_v_y", np.negative, "reference's velocity", "ref_v_y: wrong sign"),
    "velocities in km/h": ("ref_v", times(3.6), "reference's velocity", "in km/h"),
    "no velocity along an axis": (
        "ref_v_x", np.zeros_like, "frozen", "ref_v_x: a sensor that hangs"),
}  # fmt: skip
LOG_CASES: dict[str, tuple[Callable[[Log], Log], str, str]] = {
    # what is done to the log; the rule that notices it; what its line says, in part
    "gyro with x and y swapped": (exchanged(("gyro_x", "gyro_y")), "gyro", "x is y, y is x"),
    "gyro and accelerometer swapped": (
        lambda log: vectors(log, gyro=log.accel, accel=log.gyro),
        "gyro's unit", "gyro_x to accel_z: gyro and accelerometer swapped"),
    "gravity taken off": (
        lambda log: vectors(log, accel=log.accel - 9.81 * log.ref_R_GI[:, 2]),
        "gravity", "gravity was taken off"),
    "accelerometer's y and z swapped": (
        exchanged(("accel_y", "accel_z")), "gravity", "gravity is on y, up is z"),
    "accelerometer's x and y swapped": (
        exchanged(("accel_x", "accel_y")), "accelerometer", "x is y, y is x"),
    "accelerometer that is a direction": (
        lambda log: vectors(
            log, accel=9.81 * log.accel / np.linalg.norm(log.accel, axis=1, keepdims=True)
        ), "gravity", "a direction"),
    "accelerometer of gravity alone": (
        lambda log: vectors(log, accel=low_pass(log.accel, 0.5, log.rate)),
        "accelerometer", "a filter"),
    "accelerometer in the world": (
        lambda log: vectors(log, accel=np.einsum("nij,nj->ni", log.ref_R_GI, log.accel)),
        "accelerometer", "in the world's axes"),
    "IMU turned by 30 deg": (partial(imu_turned, R=turned("z", 30)), "gyro", "the IMU is turned"),
    "an axis read twice": (
        lambda log: log.with_columns({"gyro_y": log.columns["gyro_x"]}),
        "copied", "gyro_x, gyro_y"),
    "a joint read twice": (
        lambda log: log.with_columns({"q_FR_calf": log.columns["q_FL_calf"]}),
        "copied", "q_FR_calf"),
    "rates swapped": (
        exchanged(("dq_FL_thigh", "dq_FL_calf")),
        "joint rates", "FL_thigh is FL_calf, FL_calf is FL_thigh"),
    "a rate from differences": (
        partial(differenced, pattern="dq_FR_calf"), "derived", "dq_FR_calf: computed from q"),
    "velocities in the body": (velocity_in_body, "reference's velocity", "in the body's axes"),
    "north-east-down": (
        lambda log: body_turned(in_world(log, NED), NED),
        "reference's attitude", "z down"),
    "a heading that turns clockwise": (
        partial(euler_angles, read=lambda yaw, pitch, roll: (-yaw, pitch, roll)),
        "reference's attitude", "heading turns clockwise"),
    "roll and pitch swapped": (
        partial(euler_angles, read=lambda yaw, pitch, roll: (yaw, roll, pitch)),
        "reference's attitude", "roll and pitch are exchanged"),
    "positions with x and y swapped": (
        exchanged(("ref_p_x", "ref_p_y"), ("ref_v_x", "ref_v_y")),
        "accelerometer", "x is y"),
    "reference's positions turned": (
        partial(positions_turned, R=turned("z", 30)), "reference's motion", "30 deg about z"),
    "reference that sinks": (sinking, "legs", "sinks by 0.30 m/s"),
    "reference made of the legs": (leg_odometry, "reference from legs", "computed from the legs"),
    "legs swapped, left and right": (
        exchanged(("_FL", "_FR"), ("_RL", "_RR")),
        "legs", "FL is FR, FR is FL, RL is RR"),
    "two legs swapped": (exchanged(("_FL", "_FR")), "legs", "FL is FR, FR is FL"),
    "joints of two legs swapped": (
        exchanged(("q_FL", "q_FR"), ("tau_FL", "tau_FR")),
        "legs", "swapped legs (joints)"),
    "thighs and calves swapped": (exchanged(("_thigh", "_calf")), "legs", "thigh is calf"),
    "contacts inverted": (
        partial(changed, pattern="contact_", change=lambda x: 1.0 - x), "legs", "1 means lifted"),
    "contacts that flicker": (noisy_contacts, "flickering", "debounce"),
    "a second lost": (partial(dropped, rows=slice(1000, 1500)), "rows", "500 rows missing"),
    "every twentieth row lost": (partial(dropped, rows=20), "single rows", "lost rows"),
    "rows lost behind even stamps": (
        partial(dropped, rows=slice(1000, 1240), restamped=True), "jumps", "behind even stamps"),
    "rows in twos the wrong way about": (in_twos_the_wrong_way_about, "jumps", "out of order"),
    "time reversed": (
        lambda log: reordered(log, np.arange(len(log.t))[::-1]),
        "speed of time", "time runs backwards"),
    "time at 1.25 of its speed": (
        partial(stretched, factor=0.8), "speed of time", "stamps at a wrong rate"),
    "time in ms": (partial(stretched, factor=1e3), "rows", 'unit = "ms"'),
    "another rate in the metadata": (
        lambda log: replace(log, meta=replace(log.meta, rate=400.0)), "rows", "says 400 Hz"),
}  # fmt: skip
LATE_CASES: dict[str, tuple[float, str, str, str]] = {
    # by how much [s], the columns; the rule that notices it; what its line says, in part
    "reference 0.3 s late": (0.3, "ref_", "reference's attitude", "offset = -0.3"),
    "reference 0.05 s late": (0.05, "ref_", "reference's attitude", "is late"),
    "reference of another clock": (3.0, "ref_", "gyro", "another clock; try surefoot align"),
    "velocities late": (0.1, "ref_v", "late", "ms late against the change of ref_p"),
    "IMU late": (0.2, "(gyro|accel)", "reference's attitude", "is early"),
    "gyro late": (0.06, "gyro", "reference's attitude", "gyro_x, gyro_y, gyro_z: a filter"),
    "accelerometer late": (0.1, "accel", "accelerometer", "0.10 s late"),
    "rates late": (0.02, "dq_", "late", "ms late against the change of q"),
    "a rate late": (0.02, "dq_FR_calf", "late", "late = { dq_FR_calf = 0.0"),
    "legs late": (0.2, f"({JOINTS}|contact)", "legs", "0.20 s late relative to the reference"),
    "joints late by some rows": (
        0.05,
        "(q|dq)_",
        "legs",
        "clock of contacts or joints (0.06 s early",
    ),
    "torques late": (0.04, "tau_", "torques of legs", "load legs 0.04"),
    "contacts late": (0.06, "contact_", "legs", "(0.06 s late"),
    "a contact late": (0.1, "contact_RR", "legs", "contact_RR: unlike the other contacts (0.1"),
    "one leg late": (0.05, "(q|dq|tau|contact)_FL", "legs", "FL 0.04 s late"),
}
CASES = (
    LOG_CASES
    | {
        name: (partial(changed, pattern=columns, change=change), rule, words)
        for name, (columns, change, rule, words) in COLUMN_CASES.items()
    }
    | {
        name: (partial(lagging, seconds=seconds, pattern=columns), rule, words)
        for name, (seconds, columns, rule, words) in LATE_CASES.items()
    }
)


@pytest.mark.parametrize("name", CASES)
def test_nonsense_is_noticed_by_the_right_name(log, name):
    change, rule, words = CASES[name]
    findings = check_log(change(log), SPOT)
    for one in findings:
        assert_pasteable(one)
    found = [f"{one.rule}: {one.line}" for one in findings]
    assert any(line.startswith(f"{rule}: ") and words in line for line in found), found
    assert len(found) <= 3, "a rule is not asked about what an earlier one doubts"


def assert_pasteable(found: Finding) -> None:
    """What is to be pasted is TOML, and has no gaps."""
    assert "..." not in found.map_line
    assert "<" not in found.map_line
    for part in found.map_line.split("; ") if found.changes else ():
        keys, place, _ = re.split(r"( in \[| in the entry of )", part, maxsplit=1)
        of_column = re.sub(r"^the column of \w+(, |$)", "", keys) if "entry" in place else keys
        tomllib.loads(f"of = {{ {of_column} }}")


WORLDS = {  # rotation to the recorded world
    "y up": turned("x", -90), "y down": turned("x", 90), "x up": turned("y", 90), "z down": NED
}  # fmt: skip


@pytest.mark.parametrize("seconds", [0.0, 0.4, -0.6])
@pytest.mark.parametrize("world", WORLDS)
def test_another_world_is_one_finding_on_another_clock_too(log, world, seconds):
    broken = without(in_world(log, WORLDS[world]), "ref_v")
    columns = "ref_" if seconds > 0.0 else f"(gyro|accel|{JOINTS}|contact)"
    found = check_log(lagging(broken, abs(seconds), columns), SPOT)[0]
    advised = Rotation.from_quat(found.changes["reference"]["q_GW"], scalar_first=True)
    assert (advised * WORLDS[world]).magnitude() < 1e-5
    assert abs(found.changes["reference"].get("offset", 0.0) + 0.0) == pytest.approx(
        abs(seconds), abs=0.01
    )


@pytest.mark.parametrize("body", ["x", "z"])
@pytest.mark.parametrize("world", WORLDS)
def test_another_world_is_found_before_the_axes_of_the_tracked_body(log, world, body):
    broken = without(in_world(body_turned(log, turned(body, 90)), WORLDS[world]), "ref_v")
    found = check_log(broken, SPOT)[0]
    advised = Rotation.from_quat(found.changes["reference"]["q_GW"], scalar_first=True)
    assert (advised * WORLDS[world]).magnitude() < 1e-5


@pytest.mark.parametrize(("leg", "lacks"), [("FL", "x_"), ("RR", "tau_")])
def test_a_hip_of_the_opposite_sign_shows_when_a_robot_walks_straight_ahead(ahead, leg, lacks):
    """It moves about 0 rad, so that standing feet hardly move."""
    broken = changed(ahead, f"{JOINTS}{leg}_hip", np.negative)
    (found,) = check_log(without(broken, lacks), SPOT)
    assert found.changes == {"robot": {"joint_sign": {f"{leg}_hip": -1.0}}}


def test_a_clean_walk_is_plausible_with_and_without_its_robot_and_reference(log):
    assert found_in(log) == found_in(log, None) == found_in(without(log, "ref_")) == []
    # In its beginning, joints rest for a second, between two counts of their encoders.
    assert found_in(log.rows(log.t < 1.5)) == []


LOW_RATES = [(x, 0) for x in (5.0, 6.0, 8.0, 10.0, 12.5, 20.0, 25.0, 50.0)]


@pytest.mark.parametrize(
    ("rate", "first"), [*LOW_RATES, (8.0, 21), (8.0, 33), (10.0, 13), (12.5, 7)]
)
def test_rows_of_a_low_rate_are_plausible_wherever_in_a_stride_they_are(log, rate, first):
    """Averages lag by half a row, and trapezoids miss what lies between samples."""
    slow = at_rate(log.rows(np.arange(len(log.t)) >= first), rate)
    assert found_in(slow) == found_in(without(slow, "ref_")) == []


@pytest.mark.parametrize("rate", [8.0, 10.0, 20.0, 25.0, 50.0])
def test_an_imu_that_is_sampled_at_a_low_rate_is_noticed(log, rate):
    slow = at_rate(log, rate)
    rows = np.searchsorted(log.t, slow.t)
    (found,) = found_in(slow.with_columns({c: log.frame[c].to_numpy()[rows] for c in GYRO + ACCEL}))
    assert "sampled at the rows, not averaged" in found


@pytest.mark.parametrize(("every", "first"), [(5, 1), (8, 2), (10, 5)])
def test_an_imu_that_is_sampled_contradicts_no_reference(log, every, first):
    """Samples miss the impacts between them, and change the velocity by others."""
    rows = log.rows(np.arange(first, len(log.t), every))
    seen = Poses(log.t[3::5], log.ref_p[3::5], log.ref_q[3::5])
    assert not contradicted(rows.t, rows.gyro, rows.accel, seen).any()


@pytest.mark.parametrize("kinds", [(), ("ref_", "dq_"), ("ref_", "q_", "dq_", "tau_")])
def test_rows_of_2_hz_are_slow_and_not_in_ms(log, kinds):
    lines = [line for line in found_in(without(at_rate(log, 2.0), *kinds)) if "rows" in line]
    assert [line.startswith("rows: t: too slow") for line in lines] == [True]


def test_feet_that_bounce_are_no_noise_about_a_threshold(log):
    bounces = bouncing(log)
    rate = np.abs(np.diff(bounces.contact.astype(int), axis=0)).sum(axis=0) / log.t[-1]
    assert rate.min() > 30.0
    assert not named("flickering", bounces)


@pytest.mark.long
@pytest.mark.parametrize(("name", "first"), [("mini_cheetah", 0), ("hyqreal2", 1)])
def test_nonsense_is_noticed_on_other_robots(name, first, monkeypatch):
    """Every other case on each of two robots, a small and a large one."""
    robot = Robot.load(name)
    monkeypatch.setattr(sys.modules[__name__], "SPOT", robot)
    log = walk(Scenario("plain", COURSE, Ground(0.8)), robot, 5)
    assert found_in(log, robot) == []
    cases = list(CASES)[first::2]
    assert [case for case in cases if not found_in(CASES[case][0](log), robot)] == []


@pytest.mark.long
@pytest.mark.parametrize("pattern", ["trot", "pace", "walk"])
def test_clean_walks_are_plausible_wherever_they_are_cut(pattern):
    segments = Segment(5.0, 0.4), Segment(4.0, 0.0, turn=0.4)
    gait = GaitOptions(pattern=pattern)
    log = walk(Scenario("plain", segments, Ground(0.8), gait=gait), SPOT, 5)
    for begin, end in ((0.0, 1.5), (0.0, 3.0), (2.0, 6.0), (6.0, 8.0), (0.0, 10.0)):
        part = log.rows((log.t >= begin) & (log.t < end))
        assert (begin, end, found_in(part)) == (begin, end, [])
        assert (begin, end, found_in(without(part, "ref_"))) == (begin, end, [])


@pytest.mark.parametrize("name", ["go1", "mini_cheetah"])
def test_the_log_of_another_robot_is_noticed(log, name):
    found = found_in(log, Robot.load(name))
    assert any("another robot" in line or "joint_sign" in line for line in found), found


@pytest.mark.parametrize("change", ["gyro_x", "gyro_y", "gyro_z"])
def test_without_a_reference_legs_see_an_axis_that_is_not_the_gyros(log, change):
    others = {"gyro_x": "gyro_z", "gyro_y": "gyro_x", "gyro_z": "gyro_y"}
    swapped = exchanged((change, others[change]))(without(log, "ref_"))
    assert [one.rule for one in check_log(swapped, SPOT)] == ["gyro and legs"]


def test_without_its_robot_a_joint_that_hangs_is_told_from_one_that_rests(log):
    """Joints of an arm rest one by one: an angle hangs if its rate says that it turns."""
    for name in ("q_FL_calf", "dq_FL_calf"):
        assert named(f"frozen: {name}", changed(log, name, frozen), None)
    both_rest = changed(log, "q_FL_calf", frozen)
    rests = np.diff(both_rest.frame["q_FL_calf"], prepend=np.nan) == 0.0
    rate = np.where(rests, 0.0, log.frame["dq_FL_calf"])
    both_rest = both_rest.with_columns({"dq_FL_calf": rate})
    assert not named("frozen", both_rest, None)


def test_joints_of_which_one_alone_is_scaled_are_no_matter_of_the_clock(log):
    """One of two joints with 2.3 times its rate leaves the other, and the stamps, as they are."""
    two = log.frame[["t", "q_FL_calf", "q_FR_calf", "dq_FL_calf", "dq_FR_calf"]]
    (found,) = found_in(changed(replace(log, frame=two), "dq_FR_calf", times(2.3)), None)
    assert found.startswith("joint rates: dq_FR_calf: scaled")
    assert "gain = 0.43" in found


def test_few_spikes_of_a_short_log_of_an_arm_are_noticed(log):
    t = 0.01 * np.arange(400)
    q, rng = 0.3 * np.sin(2.0 * t), np.random.default_rng(0)
    rate = 0.6 * np.cos(2.0 * t) + rng.normal(0.0, 0.01, len(t))
    arm = Log(pd.DataFrame({"t": t, "q_elbow": q, "dq_elbow": rate}), Meta(rate=100.0), "arm")
    assert found_in(arm, None) == []
    rate[[50, 121, 200, 222, 301, 350]] += 3.0
    assert named("spikes: dq_elbow", arm.with_columns({"dq_elbow": rate}), None)


def test_forces_that_are_held_have_their_line_for_the_map(log):
    rng = np.random.default_rng(0)
    forces = {f"force_{leg}_z": rng.uniform(0.0, 90.0, len(log.t)) for leg in log.legs}
    slow = {name: np.repeat(x[::10], 10)[: len(log.t)] for name, x in forces.items()}
    flat = {f"force_{leg}_{a}": np.zeros(len(log.t)) for leg in log.legs for a in "xy"}
    assert any('held = ["force"]' in line for line in found_in(log.with_columns(flat | slow)))


def test_rates_that_leap_as_their_angle_does_are_no_spikes(log):
    """A foot that chatters on the ground turns its joint to and fro within four rows."""
    there = (log.t > 3.0) & (log.t < 3.05)
    rate = np.where(there, 12.0 * np.array([0.0, 1.0, 0.0, -1.0])[np.arange(len(log.t)) % 4], 0.0)
    angle = np.cumsum(rate) / log.meta.rate
    q, dq = (log.frame[column].to_numpy() for column in ("q_FL_calf", "dq_FL_calf"))
    chatters = log.with_columns({"q_FL_calf": q + angle, "dq_FL_calf": dq + rate})
    assert found_in(chatters) == []
    garbled = chatters.with_columns({"q_FL_calf": q})
    assert named("spikes: dq_FL_calf", garbled)


def test_coarse_readings_that_pass_by_zero_are_no_drop_outs():
    """At impacts a reading of 0.1 is as frequent as one of 0."""
    usual = np.random.default_rng(0).normal(5.0, 0.3, 4000).round(1)
    at = np.arange(10, 4000, 40)
    impacts, lacking = usual.copy(), usual.copy()
    impacts[at] = 0.1 * (np.arange(len(at)) % 5 - 2)
    lacking[at] = 0.0
    assert np.sum(impacts == 0.0) == 20
    assert _drop_outs(impacts) == 0
    assert _drop_outs(lacking) == len(at)


def test_a_joint_that_is_held_throughout_rests_and_one_whose_rate_moves_hangs(log):
    """Between two counts of its encoder a joint at rest stays for seconds."""
    count = 1.5e-3 * (np.sin(np.arange(len(log.t))) > 0.9)
    count[len(count) // 4 : len(count) // 2] = 0.0
    rate = log.frame["dq_FL_hip"].to_numpy()
    still = log.with_columns({"q_FL_hip": count, "dq_FL_hip": np.gradient(count, log.t)})
    assert not named("frozen", still)
    for other in (still.with_columns({"dq_FL_hip": rate}), without(still, "dq_")):
        assert named("frozen: q_FL_hip", changed(other, "q_FL_hip", np.zeros_like))


@pytest.mark.parametrize(
    ("window", "sign", "cause"),
    [(0.18, 1.0, "no rate of this joint"), (0.01, 1.0, ""), (0.01, -1.0, "wrong sign")],
)
def test_a_vibration_that_a_filter_inverts_has_no_wrong_sign(window, sign, cause):
    """A moving average of 1.4 periods is in its first negative sidelobe."""
    t = np.arange(0.0, 8.0, 0.01)
    angles = {"arm": np.sin(6.0 * t), "leg": np.cos(4.0 * t), "head": 0.01 * np.sin(50.0 * t)}
    columns = {"t": t} | {f"q_{joint}": q for joint, q in angles.items()}
    columns |= {f"dq_{joint}": np.gradient(q, t) for joint, q in angles.items()}
    rows = 2 * round(window / 0.02) + 1
    columns["dq_head"] = sign * uniform_filter1d(columns["dq_head"], rows)
    found = check_log(Log(pd.DataFrame(columns), Meta(rate=100.0), "shaking"))
    causes = [one.cause for one in found if one.streams == ("dq_head",)]
    assert len(causes) == bool(cause)
    assert all(one.startswith(cause) for one in causes)


@pytest.mark.parametrize("rows", [1, 2, 5])
def test_a_log_of_some_rows_has_nothing_to_compare(log, rows):
    assert found_in(log.rows(slice(rows))) == []


def test_a_note_and_a_fault_of_a_stream_are_both_found(log):
    found = check_log(exchanged(("gyro_x", "gyro_y"))(changed(log, "gyro_z", clipped)), SPOT)
    assert {"saturated", "gyro"} <= {one.rule for one in found}


def test_every_rule_has_a_place_says_why_and_needs_what_logs_have():
    """What no log has would always be missing, and the rule would never speak."""
    files = [x for name, x in sys.modules.items() if name.startswith("surefoot.sim.plausibility.")]
    declared = {one.name for file in files for one in vars(file).values() if isinstance(one, Rule)}
    assert declared == {rule.name for rule in RULES}
    assert len(declared) == len(RULES)
    for row in rules_table():
        assert [*row] == ["Rule", *PARAGRAPHS]
        assert min(map(len, row.values())) > 2
        assert "{" not in "".join(row.values())
    known = ["t", *(name for names in GROUPS.values() for name in names)]
    for rule in RULES:
        assert all(any(c.startswith(need) for c in known) for need in (*rule.needs, *rule.beside))


DEAD, INVERTED = "dead sensor", "inverted"
FAULTS = {  # legs, what their contact becomes, the cause that is named
    "all on": (LEGS, np.ones_like, DEAD),
    "all off": (LEGS, np.zeros_like, DEAD),
    "all off but one": (LEGS[1:], np.zeros_like, DEAD),
    "one on": (("FL",), np.ones_like, DEAD),
    "one off": (("RR",), np.zeros_like, DEAD),
    "a diagonal on": (("FR", "RL"), np.ones_like, DEAD),
    "two in front off": (("FL", "FR"), np.zeros_like, DEAD),
    "one inverted": (("RL",), lambda x: 1.0 - x, INVERTED),
    "all inverted": (LEGS, lambda x: 1.0 - x, INVERTED),
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("reference", [True, False])
def test_a_fault_of_contacts_is_named_in_a_second_of_walking(ahead, fault, reference):
    legs, change, cause = FAULTS[fault]
    log = ahead.rows((ahead.t >= 2.5) & (ahead.t < 3.5))
    log = log.with_columns({f"contact_{x}": change(log.frame[f"contact_{x}"]) for x in legs})
    found = check_log(log if reference else without(log, "ref_"), SPOT)
    if fault.startswith("all off") and not reference:
        assert found == (), "it may hang in the air"
        return
    assert all(cause in one.cause for one in found)
    named = {name for one in found for name in one.streams}
    assert named >= {f"contact_{leg}" for leg in legs}


@pytest.mark.parametrize("seconds", [0.5, 1.0])
def test_good_contacts_of_short_logs_are_not_doubted(ahead, seconds):
    for start in np.arange(0.0, 3.0, 0.7):  # standing, the first steps, walking
        log = ahead.rows((ahead.t >= start) & (ahead.t < start + seconds))
        assert not [x for x in check_log(log, SPOT) if x.streams[0].startswith("contact")]


SECONDS = 12.0
"""Of each course that is walked [s]."""


@pytest.mark.long
@pytest.mark.parametrize("course", bundled_scenarios())
def test_no_warning_is_given_on_a_bundled_course(course):
    scenario = Scenario.load(scenario_file(course))
    robot = Robot.load(scenario.robot or "spot_class")
    log = walk(beginning(scenario), robot, 0)
    assert log.t[-1] > 5.0
    assert [one.line for one in check_log(log, robot)] == []
    assert [one.line for one in check_log(log)] == []


def beginning(scenario: Scenario) -> Scenario:
    """The course's first SECONDS."""
    kept, left = [], SECONDS
    for segment in scenario.segments:
        if left > 0.0:
            kept.append(replace(segment, duration=min(segment.duration, left)))
            left -= segment.duration
    return replace(scenario, segments=tuple(kept))
