"""One short walk, made nonsense in many ways: each is noticed, by the right rule and name."""

import re
import sys
import tomllib
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation
from synthetic import without

from surefoot.sim.common.series import low_pass
from surefoot.sim.gait.options import GaitOptions
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.importing.advice import Changes
from surefoot.sim.importing.reference_check import contradicted
from surefoot.sim.log import Log, Meta
from surefoot.sim.log.reference import Poses
from surefoot.sim.log.schema import GROUPS
from surefoot.sim.plausibility import RULES, check_log, rules_table
from surefoot.sim.plausibility.axes import lag_of, match_axes
from surefoot.sim.plausibility.finding import PARAGRAPHS, Finding
from surefoot.sim.plausibility.streams import _drop_outs
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk

SPOT = Robot.load("spot_class")
COURSE = (Segment(2.5, 0.7), Segment(3.0, 0.5, turn=0.6), Segment(2.5, 0.7, turn=-0.4))
GYRO, ACCEL = ([f"{kind}_{a}" for a in "xyz"] for kind in ("gyro", "accel"))
DEGREE = 180.0 / np.pi
NED = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))


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


def test_a_clean_walk_is_plausible_with_and_without_its_robot_and_reference(log):
    assert found_in(log) == found_in(log, None) == found_in(without(log, "ref_")) == []


def test_the_beginning_of_a_walk_is_plausible(log):
    """Its joints rest for a second, between two counts of their encoders."""
    assert found_in(log.rows(log.t < 1.5)) == []


def test_dead_contacts_of_a_second_are_noticed(log):
    second = log.rows((log.t >= 2.0) & (log.t < 3.0))
    assert found_in(second) == []
    (line,) = found_in(constant(0.0, "contact_")(second))
    assert line.startswith("contacts: contact_FL")
    assert "always 0" in line


@pytest.mark.parametrize("rate", [5.0, 6.0, 8.0, 10.0, 12.5, 20.0, 25.0, 50.0])
def test_rows_of_a_low_rate_are_plausible(log, rate):
    """Averages lag by half a row, and trapezoids miss what lies between samples."""
    assert found_in(at_rate(log, rate)) == []
    assert found_in(without(at_rate(log, rate), "ref_")) == []


@pytest.mark.parametrize(("rate", "first"), [(8.0, 21), (8.0, 33), (10.0, 13), (12.5, 7)])
def test_rows_of_a_low_rate_are_plausible_wherever_in_a_stride_they_are(log, rate, first):
    assert found_in(at_rate(log.rows(np.arange(len(log.t)) >= first), rate)) == []


@pytest.mark.parametrize("rate", [8.0, 10.0, 20.0, 25.0, 50.0])
def test_an_imu_that_is_sampled_at_a_low_rate_is_noticed(log, rate):
    slow = at_rate(log, rate)
    rows = np.searchsorted(log.t, slow.t)
    (found,) = found_in(edited(slow, **{c: log.frame[c].to_numpy()[rows] for c in GYRO + ACCEL}))
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
    changed = bouncing(log)
    rate = np.abs(np.diff(changed.contact.astype(int), axis=0)).sum(axis=0) / log.t[-1]
    assert rate.min() > 30.0
    assert not named("flickering", changed)


# What is done to a log.


def at_rate(log: Log, rate: float) -> Log:
    """Rows of a lower rate, over which the IMU is averaged."""
    n = round(log.rate / rate)
    rows = np.arange(n, len(log.t), n)
    summed = np.cumsum(np.column_stack([log.gyro, log.accel]), axis=0)
    averaged = (summed[rows] - summed[rows - n]) / n
    slow = edited(log.rows(rows), **dict(zip([*GYRO, *ACCEL], averaged.T, strict=True)))
    return replace(slow, meta=replace(log.meta, rate=log.rate / n))


def edited(log: Log, **columns) -> Log:
    return replace(log, frame=log.frame.assign(**columns))


def columns_of(log: Log, *prefixes: str) -> list[str]:
    commands = ("q_des", "dq_des", "tau_ff")
    named = [str(c) for c in log.frame if str(c).startswith(prefixes)]
    return [c for c in named if not c.startswith(commands)]


def times(factor: float, *prefixes: str, ends: str = "") -> Callable[[Log], Log]:
    def change(log: Log) -> Log:
        names = [c for c in columns_of(log, *prefixes) if c.endswith(ends)]
        assert names
        return edited(log, **{c: factor * log.frame[c] for c in names})

    return change


def plus(amount: float, column: str) -> Callable[[Log], Log]:
    return lambda log: edited(log, **{column: log.frame[column] + amount})


def constant(value: float, *prefixes: str) -> Callable[[Log], Log]:
    return lambda log: edited(log, **dict.fromkeys(columns_of(log, *prefixes), value))


def exchanged(*pairs: tuple[str, str]) -> Callable[[Log], Log]:
    """Columns exchanged, whole families of them by a part of their name."""

    def change(log: Log) -> Log:
        values = {}
        for a, b in pairs:
            for c in map(str, log.frame):
                if a in c and not c.startswith(("slip", "mu")):
                    other = c.replace(a, b)
                    values |= {c: log.frame[other], other: log.frame[c]}
        assert values
        return edited(log, **values)

    return change


def inverted(*legs: str) -> Callable[[Log], Log]:
    return lambda log: edited(
        log, **{f"contact_{x}": 1.0 - log.frame[f"contact_{x}"] for x in legs}
    )


def attitude(read: Callable[[Rotation], Rotation]) -> Callable[[Log], Log]:
    def change(log: Log) -> Log:
        q = read(Rotation.from_quat(log.ref_q, scalar_first=True)).as_quat(scalar_first=True)
        return edited(log, **{f"ref_q_{a}": q[:, i] for i, a in enumerate("wxyz")})

    return change


def euler_angles(read: Callable[..., tuple[np.ndarray, ...]]) -> Callable[[Log], Log]:
    """Attitudes with other Euler angles, given yaw, pitch and roll."""

    def change(R: Rotation) -> Rotation:
        return Rotation.from_euler("ZYX", np.column_stack(read(*R.as_euler("ZYX").T)))

    return attitude(change)


def from_another_zero(offset: float, kind: str) -> Callable[[Log], Log]:
    def change(log: Log) -> Log:
        names = [c for c in columns_of(log, "q_") if c.endswith(kind)]
        return edited(log, **{c: log.frame[c] + offset for c in names})

    return change


def imu_turned(R: Rotation) -> Callable[[Log], Log]:
    def change(log: Log) -> Log:
        gyro, accel = R.apply(log.gyro), R.apply(log.accel)
        both = {n: x[:, i] for ns, x in ((GYRO, gyro), (ACCEL, accel)) for i, n in enumerate(ns)}
        return edited(log, **both)

    return change


def both(*changes: Callable[[Log], Log]) -> Callable[[Log], Log]:
    def change(log: Log) -> Log:
        for one in changes:
            log = one(log)
        return log

    return change


def late(seconds: float, *prefixes: str) -> Callable[[Log], Log]:
    def change(log: Log) -> Log:
        rows, names = round(seconds * log.rate), columns_of(log, *prefixes)
        frame = log.frame.iloc[rows:].reset_index(drop=True)
        frame[names] = log.frame[names].iloc[: len(frame)].to_numpy()
        return replace(log, frame=frame)

    return change


def frozen(*prefixes: str) -> Callable[[Log], Log]:
    def change(log: Log) -> Log:
        frame, first, last = log.frame.copy(), len(log.t) // 3, len(log.t) // 2
        names = columns_of(log, *prefixes)
        frame.loc[first:last, names] = frame.loc[first, names].to_numpy()
        return replace(log, frame=frame)

    return change


def dropped(rows: slice | int, restamped: bool = False) -> Callable[[Log], Log]:
    def change(log: Log) -> Log:
        gone = np.zeros(len(log.t), dtype=bool)
        gone[rows if isinstance(rows, slice) else np.arange(7, len(log.t), rows)] = True
        found = log.rows(~gone)
        return edited(found, t=np.arange(len(found.t)) / log.rate) if restamped else found

    return change


def clipped(column: str) -> Callable[[Log], Log]:
    def change(log: Log) -> Log:
        x = log.frame[column]
        return edited(log, **{column: x.clip(x.quantile(0.1), x.quantile(0.9))})

    return change


def leaping(size: float, column: str) -> Callable[[Log], Log]:
    def change(log: Log) -> Log:
        x = log.frame[column].to_numpy().copy()
        x[100::500] += size
        return edited(log, **{column: x})

    return change


def zeroed(*prefixes: str) -> Callable[[Log], Log]:
    def change(log: Log) -> Log:
        frame = log.frame.copy()
        frame.loc[50::200, columns_of(log, *prefixes)] = 0.0
        return replace(log, frame=frame)

    return change


def stretched(factor: float) -> Callable[[Log], Log]:
    def change(log: Log) -> Log:
        meta = replace(log.meta, rate=log.rate / factor)
        return replace(edited(log, t=factor * log.t), meta=meta)

    return change


def in_body(log: Log) -> Log:
    v = np.einsum("nji,nj->ni", log.ref_R_GI, log.ref_v)
    return edited(log, **{f"ref_v_{a}": v[:, i] for i, a in enumerate("xyz")})


def no_gravity(log: Log) -> Log:
    up = 9.81 * log.ref_R_GI[:, 2]
    return edited(log, **{a: log.frame[a] - up[:, i] for i, a in enumerate(ACCEL)})


def differenced(log: Log) -> Log:
    names = columns_of(log, "dq_")
    return edited(log, **{c: np.gradient(log.frame[c[1:]], log.t) for c in names})


def in_unit(seconds: float) -> Callable[[Log], Log]:
    """Stamps and rate as if another unit of time were s."""
    return lambda log: replace(
        edited(log, t=log.t / seconds), meta=replace(log.meta, rate=log.rate * seconds)
    )


def straight(every: int, *prefixes: str) -> Callable[[Log], Log]:
    """Columns on straight lines between each so many rows."""

    def change(log: Log) -> Log:
        rows = np.arange(len(log.t))
        names = columns_of(log, *prefixes)
        return edited(
            log, **{c: np.interp(rows, rows[::every], log.frame[c][::every]) for c in names}
        )

    return change


def swapped_rows(log: Log) -> Log:
    rows = np.arange(len(log.t) // 2 * 2).reshape(-1, 2)[:, ::-1].ravel()
    found = log.rows(rows)
    return edited(found, t=log.t[: len(rows)])


def vectors(**made: np.ndarray) -> Callable[[Log], Log]:
    return lambda log: edited(
        log, **{f"{n}_{a}": x[:, i] for n, x in made.items() for i, a in enumerate("xyz")}
    )


def directions(log: Log) -> Log:
    return vectors(accel=9.81 * log.accel / np.linalg.norm(log.accel, axis=1, keepdims=True))(log)


def gravity_alone(log: Log) -> Log:
    return vectors(accel=low_pass(log.accel, 0.5, log.rate))(log)


def accel_in_world(log: Log) -> Log:
    return vectors(accel=np.einsum("nij,nj->ni", log.ref_R_GI, log.accel))(log)


def tilted_world(log: Log) -> Log:
    R = Rotation.from_euler("x", 12, degrees=True)
    moved = vectors(ref_p=R.apply(log.ref_p), ref_v=R.apply(log.ref_v))(log)
    return attitude(lambda attitudes: R * attitudes)(moved)


def sinking(log: Log) -> Log:
    fallen = {"ref_p_z": log.frame["ref_p_z"] - 0.3 * log.t, "ref_v_z": log.frame["ref_v_z"] - 0.3}
    return edited(log, **fallen)


def noisy_contacts(log: Log) -> Log:
    wrong = np.random.default_rng(0).random(log.contact.shape) < 0.1
    both = (log.contact ^ wrong).astype(float)
    return edited(log, **{f"contact_{leg}": both[:, i] for i, leg in enumerate(log.legs)})


def bouncing(log: Log) -> Log:
    """Each landing and lift is followed by eight short changes, as on ice."""
    at = np.flatnonzero(np.diff(log.contact.astype(int), axis=0).any(axis=1))
    contact = log.contact.copy()
    for row in at[at < len(contact) - 20]:
        changed = contact[row] != contact[row + 1]
        contact[row + 2 : row + 17 : 4, changed] = log.contact[row, changed]
    return edited(log, **{f"contact_{x}": contact[:, i] for i, x in enumerate(log.legs)})


def reversed_in_time(log: Log) -> Log:
    return replace(log, frame=log.frame.iloc[::-1].reset_index(drop=True).assign(t=log.t))


def noisy_gyro(log: Log) -> Log:
    noise = np.random.default_rng(0).normal(0.0, 0.5, log.gyro.shape)
    return vectors(gyro=log.gyro + noise)(log)


def of_another_point(x: float, y: float, z: float) -> Callable[[Log], Log]:
    def change(log: Log) -> Log:
        p_IM, R = np.array([x, y, z]), log.ref_R_GI
        turning = np.einsum("nij,nj->ni", R, np.cross(log.gyro, p_IM))
        return vectors(ref_p=log.ref_p + R @ p_IM, ref_v=log.ref_v + turning)(log)

    return change


def positions_turned(log: Log) -> Log:
    R = Rotation.from_euler("z", 30, degrees=True)
    return vectors(ref_p=R.apply(log.ref_p), ref_v=R.apply(log.ref_v))(log)


def leg_odometry(log: Log) -> Log:
    """The reference's positions as legs and gyro have them."""
    feet, on = SPOT.feet_I(log.q), log.contact[:, :, None]
    by_leg = -(np.gradient(feet, log.t, axis=0) + np.cross(log.gyro[:, None], feet))
    v_I = np.sum(by_leg * on, axis=1) / np.maximum(on.sum(axis=1), 1)
    v_GI = np.einsum("nij,nj->ni", log.ref_R_GI, v_I)
    p = log.ref_p[0] + np.cumsum(v_GI, axis=0) / log.rate
    return vectors(ref_p=p, ref_v=v_GI)(log)


def scrambled(log: Log) -> Log:
    """Gyro and accelerometer read as each other."""
    return vectors(gyro=log.accel, accel=log.gyro)(log)


def noisy(size: float, *prefixes: str) -> Callable[[Log], Log]:
    def change(log: Log) -> Log:
        rng = np.random.default_rng(0)
        names = columns_of(log, *prefixes)
        return edited(log, **{c: log.frame[c] + rng.normal(0.0, size, len(log.t)) for c in names})

    return change


def rounded(step: float, *prefixes: str) -> Callable[[Log], Log]:
    return lambda log: edited(
        log, **{c: step * np.round(log.frame[c] / step) for c in columns_of(log, *prefixes)}
    )


def overflowing(log: Log) -> Log:
    return edited(log, gyro_x=(20.0 * log.frame["gyro_x"] + 4.0) % 8.0 - 4.0)


def within_a_turn(log: Log) -> Log:
    q = log.frame["q_FL_calf"]
    return edited(log, q_FL_calf=(q - q.median()) % (2.0 * np.pi))


def disconnected(log: Log) -> Log:
    """A leg's joints at zero for a while."""
    frame = log.frame.copy()
    frame.loc[2000:2150, columns_of(log, "q_RL", "dq_RL", "tau_RL")] = 0.0
    return replace(log, frame=frame)


def every_second_step(log: Log) -> Log:
    contact = log.frame["contact_FR"].to_numpy().copy()
    down, up = (np.flatnonzero(np.diff(contact) == change) for change in (1.0, -1.0))
    for first in down[::2]:
        contact[first : up[up > first].min(initial=len(contact)) + 1] = 0.0
    return edited(log, contact_FR=contact)


z_down = both(times(-1, "ref_p_y", "ref_v_y"), times(-1, "ref_p_z", "ref_v_z"))

CASES: dict[str, tuple[Callable[[Log], Log], str, str]] = {
    # what is done to the log; the rule that notices it; what its line says, in part
    "gyro in deg/s": (times(DEGREE, "gyro"), "gyro's unit", 'unit = "deg/s"'),
    "gyro all zero": (constant(0.0, "gyro"), "frozen", "gyro_x, gyro_y, gyro_z"),
    "gyro with x and y swapped": (exchanged(("gyro_x", "gyro_y")), "gyro", "x is y, y is x"),
    "gyro with z of the wrong sign": (times(-1, "gyro_z"), "gyro", "gyro_z: z is -z"),
    "gyro negated": (times(-1, "gyro"), "gyro", "x is -x, y is -y, z is -z"),
    "gyro scaled": (times(1.4, "gyro"), "gyro", "1.4 times as fast"),
    "gyro biased": (plus(0.8, "gyro_z"), "gyro", "gyro_z: a bias"),
    "accelerometer in g": (times(1 / 9.80665, "accel"), "gravity", 'unit = "g"'),
    "accelerometer in mm/s^2": (times(1e3, "accel"), "gravity", "in mm/s^2"),
    "accelerometer negated": (times(-1, "accel"), "gravity", "gravity was logged"),
    "accelerometer's z negated": (times(-1, "accel_z"), "gravity", "accel_z: wrong sign"),
    "gravity of the wrong sign": (plus(-19.62, "accel_z"), "gravity", "offset = 19.62"),
    "gravity taken off": (no_gravity, "gravity", "gravity was taken off"),
    "accelerometer scaled": (times(1.2, "accel"), "gravity", "scaled by 1.2"),
    "accelerometer's y and z swapped": (
        exchanged(("accel_y", "accel_z")), "gravity", "gravity is on y, up is z"),
    "accelerometer's x and y swapped": (
        exchanged(("accel_x", "accel_y")), "accelerometer", "x is y, y is x"),
    "IMU turned about z": (
        imu_turned(Rotation.from_euler("z", 90, degrees=True)), "gyro", "the IMU is turned"),
    "IMU with z down": (imu_turned(NED), "gravity", "accel_z"),
    "angles in deg": (times(DEGREE, "q_"), "joints' unit", 'unit = "deg"'),
    "angles and rates in deg": (times(DEGREE, "q_", "dq_"), "joints' unit", 'unit = "deg"'),
    "rates in deg/s": (times(DEGREE, "dq_"), "joint rates", 'unit = "deg/s"'),
    "a rate of the wrong sign": (
        times(-1, "dq_FL_calf"), "joint rates", "dq_FL_calf: wrong sign"),
    "rates swapped": (
        exchanged(("dq_FL_thigh", "dq_FL_calf")), "joint rates", "the rate of FL_calf"),
    "rates from differences": (differenced, "derived", "computed from q"),
    "a rate from differences": (
        lambda log: edited(log, dq_FR_calf=np.gradient(log.frame["q_FR_calf"], log.t)),
        "derived", "dq_FR_calf: computed from q"),
    "a rate late": (late(0.02, "dq_FR_calf"), "late", "late = { dq_FR_calf = 0.0"),
    "an angle whose sign changes": (
        lambda log: edited(log, q_FR_thigh=np.where(log.t > 5.0, -1, 1) * log.frame["q_FR_thigh"]),
        "joint rates", "dq_FR_thigh: its sign, or that of its angle, changes during the log"),
    "rates late": (late(0.02, "dq_"), "late", "ms late against the change of q"),
    "torques in mN m": (times(1e3, "tau_"), "torque", 'unit = "mN m"'),
    "torques negated": (times(-1, "tau_"), "support", "wrong sign"),
    "torques of the motor": (times(1 / 8, "tau_"), "support", "a motor's side"),
    "positions in mm": (times(1e3, "ref_p"), "reference's unit", 'unit = "mm"'),
    "velocities in mm/s": (times(1e3, "ref_v"), "reference's velocity", 'unit = "mm/s"'),
    "velocities in the body": (in_body, "reference's velocity", "in the body's axes"),
    "quaternions x, y, z, w": (
        attitude(lambda R: Rotation.from_quat(R.as_quat(), scalar_first=True)),
        "reference's attitude", "order is x, y, z, w"),
    "quaternions of the inverse": (
        attitude(Rotation.inv), "reference's attitude", "turns the world to the body"),
    "north-east-down": (
        both(attitude(lambda R: NED * R * NED), z_down), "reference's attitude", "z down"),
    "the world's z down": (
        both(attitude(lambda R: NED * R), z_down), "reference's attitude", "z down"),
    "positions with z down": (
        times(-1, "ref_p_z", "ref_v_z"), "accelerometer", "ref_p_z: z is down"),
    "positions with x and y swapped": (
        exchanged(("ref_p_x", "ref_p_y"), ("ref_v_x", "ref_v_y")), "accelerometer", "x is y"),
    "reference 0.3 s late": (late(0.3, "ref_"), "reference's attitude", "offset = -0.3"),
    "reference 0.05 s late": (late(0.05, "ref_"), "reference's attitude", "is late"),
    "reference of another clock": (late(3.0, "ref_"), "gyro", "another clock; try surefoot align"),
    "IMU late": (late(0.2, "gyro", "accel"), "reference's attitude", "is early"),
    "joints late": (late(0.2, "q_", "dq_", "tau_", "contact"), "legs", "move 0.20 s after"),
    "legs swapped, left and right": (
        exchanged(("_FL", "_FR"), ("_RL", "_RR")), "legs", "FL is FR, FR is FL, RL is RR"),
    "legs swapped, front and rear": (
        exchanged(("_FL", "_RL"), ("_FR", "_RR")), "legs", "FL is RL, FR is RR"),
    "two legs swapped": (exchanged(("_FL", "_FR")), "legs", "FL is FR, FR is FL"),
    "joints of two legs swapped": (
        exchanged(("q_FL", "q_FR"), ("tau_FL", "tau_FR")), "legs", "swapped legs (joints)"),
    "contacts of two legs swapped": (
        exchanged(("contact_FL", "contact_FR")), "legs", "swapped legs (contacts)"),
    "hips and thighs swapped": (exchanged(("_hip", "_thigh")), "legs", "FL_hip is FL_thigh"),
    "thighs and calves swapped": (exchanged(("_thigh", "_calf")), "legs", "FL_thigh is FL_calf"),
    "calves of the wrong sign": (
        times(-1, "q_", "dq_", "tau_", ends="_calf"), "legs", "FL_calf = -1"),
    "hips of the wrong sign": (times(-1, "q_", "dq_", "tau_", ends="_hip"), "legs", "FL_hip = -1"),
    "right hips mirrored": (
        times(-1, "q_", "dq_", "tau_", ends="R_hip"), "legs", "q_FR_hip, q_RR_hip: wrong sign"),
    "contacts inverted": (inverted("FL", "FR", "RL", "RR"), "legs", "inverted: 1 means lifted"),
    "one contact inverted": (inverted("RL"), "contact heights", "contact_RL"),
    "a contact always on": (constant(1.0, "contact_FL"), "contacts", "contact_FL: a dead sensor"),
    "contacts always off": (constant(0.0, "contact_"), "contacts", "always 0"),
    "a contact stuck for a while": (frozen("contact_RR"), "contacts", "contact_RR"),
    "an axis frozen": (frozen("gyro_y"), "frozen", "gyro_y: a sensor that hangs"),
    "a joint frozen": (frozen("q_FL_calf"), "frozen", "q_FL_calf"),
    "a joint and its rate frozen": (frozen("q_FL_calf", "dq_FL_calf"), "frozen", "dq_FL_calf"),
    "reference frozen": (frozen("ref_"), "frozen", "ref_p_x to ref_v_z"),
    "gyro saturated": (clipped("gyro_x"), "saturated", "gyro_x"),
    "accelerometer saturated": (clipped("accel_z"), "saturated", "accel_z"),
    "a second lost": (dropped(slice(1000, 1500)), "rows", "500 rows missing"),
    "every twentieth row lost": (dropped(20), "single rows", "lost rows"),
    "rows lost behind even stamps": (
        dropped(slice(1000, 1240), restamped=True), "jumps", "behind even stamps"),
    "time at half its speed": (stretched(2.0), "speed of time", "2 times the change"),
    "time at 1.25 of its speed": (stretched(0.8), "speed of time", "stamps at a wrong rate"),
    "time reversed": (reversed_in_time, "speed of time", "time runs backwards"),
    "another rate in the metadata": (
        lambda log: replace(log, meta=replace(log.meta, rate=400.0)), "rows", "says 400 Hz"),
    "spikes in a joint": (leaping(1.0, "q_FL_calf"), "spikes", "q_FL_calf"),
    "spikes in the gyro": (leaping(20.0, "gyro_x"), "spikes", "gyro_x"),
    "spikes in the reference": (leaping(1.0, "ref_p_x"), "spikes", "ref_p_x"),
    "joints dropped to zero": (zeroed("q_"), "spikes", "drop-outs"),
    "accelerometer dropped to zero": (zeroed("accel"), "spikes", "drop-outs"),
    "an axis read twice": (
        lambda log: edited(log, gyro_y=log.frame["gyro_x"]), "copied", "gyro_x, gyro_y"),
    "a joint read twice": (
        lambda log: edited(log, q_FR_calf=log.frame["q_FL_calf"]), "copied", "q_FR_calf"),
    "time in ms": (in_unit(1e-3), "rows", 'unit = "ms"'),
    "time in us": (in_unit(1e-6), "rows", 'unit = "us"'),
    "rows in twos the wrong way about": (swapped_rows, "jumps", "out of order"),
    "joints between a few readings": (
        straight(5, "q_", "dq_"), "interpolated", "readings at 100 Hz"),
    "reference at 5 Hz": (straight(100, "ref_p"), "interpolated", "ref_p_x"),
    "rates all zero": (constant(0.0, "dq_"), "frozen", "dq_FL_hip"),
    "velocities all zero": (constant(0.0, "ref_v"), "frozen", "ref_v_x"),
    "accelerometer late": (late(0.1, "accel"), "accelerometer", "0.10 s late"),
    "accelerometer that is a direction": (directions, "gravity", "a direction"),
    "accelerometer of gravity alone": (gravity_alone, "accelerometer", "a filter"),
    "accelerometer in the world": (accel_in_world, "accelerometer", "in the world's axes"),
    "gyro that drifts": (
        lambda log: edited(log, gyro_z=log.frame["gyro_z"] + np.linspace(0.0, 0.6, len(log.t))),
        "gyro", "rad/s off"),
    "a weak axis": (times(0.3, "gyro_z"), "gyro", "gyro_z: scaled"),
    "IMU turned by 30 deg": (
        imu_turned(Rotation.from_euler("z", 30, degrees=True)), "gyro", "the IMU is turned"),
    "reference's world not level": (tilted_world, "accelerometer", "not level"),
    "reference that sinks": (sinking, "legs", "sinks by 0.30 m/s"),
    "gyro that is noise": (noisy_gyro, "noise", "gyro_x, gyro_y, gyro_z"),
    "reference of a point before the IMU": (
        of_another_point(0.5, 0.0, 0.0), "reference's point", "of a point at (0.5"),
    "reference of a point above the IMU": (
        of_another_point(0.0, 0.0, 0.5), "reference's point", "0.50) m in the IMU's axes"),
    "reference scaled": (
        times(1.2, "ref_p", "ref_v"), "reference's motion", "times that of the accelerometer"),
    "reference's positions turned": (positions_turned, "reference's motion", "30 deg about z"),
    "reference made of the legs": (leg_odometry, "reference from legs", "computed from the legs"),
    "joints late by some rows": (late(0.05, "q_", "dq_"), "legs", "or joints are late"),
    "contacts late": (late(0.06, "contact_"), "legs", "0.06 s earlier"),
    "one leg late": (
        late(0.05, "q_FL", "dq_FL", "tau_FL", "contact_FL"), "legs", "FL moves 0.04 s after"),
    "torques late": (late(0.04, "tau_"), "late torques", "load legs 0.04"),
    "a hip's wrong zero": (plus(0.2, "q_RL_hip"), "zeros", "q_RL_hip, q_RR_hip"),
    "velocities late": (late(0.1, "ref_v"), "late", "ms late against the change of ref_p"),
    "a wrong zero": (plus(0.4, "q_FL_thigh"), "zeros", "q_FL_thigh, q_FR_thigh"),
    "torques without a sign": (
        lambda log: edited(log, **{c: log.frame[c].abs() for c in columns_of(log, "tau_")}),
        "magnitudes", "without their sign"),
    "contacts that flicker": (noisy_contacts, "flickering", "debounce"),
    "gyro in rpm": (times(30.0 / np.pi, "gyro"), "gyro", 'unit = "rpm"'),
    "gyro and accelerometer swapped": (
        scrambled, "gyro's unit", "gyro_x to accel_z: gyro and accelerometer swapped"),
    "gyro that overflows": (overflowing, "overflow", "gyro_x: numbers that overflow"),
    "gyro rounded": (rounded(0.1, "gyro"), "coarse", "readings are 0.1 apart"),
    "accelerometer in cm/s^2": (times(100.0, "accel"), "gravity", "in cm/s^2"),
    "accelerometer in mg": (times(1e3 / 9.80665, "accel"), "gravity", 'unit = "mg"'),
    "accelerometer in ft/s^2": (times(1.0 / 0.3048, "accel"), "gravity", "in ft/s^2"),
    "accelerometer that is noise": (
        noisy(4.0, "accel"), "noise", "accel_x, accel_y, accel_z"),
    "a rate that is noise": (noisy(3.0, "dq_FL_calf"), "noise", "dq_FL_calf"),
    "an angle within a turn": (within_a_turn, "overflow", "wrap = 6.28"),
    "a leg disconnected for a while": (disconnected, "spikes", "q_RL_hip, q_RL_thigh, q_RL_calf"),
    "a contact late": (late(0.1, "contact_RR"), "legs", "contact_RR: late, unlike the other"),
    "a contact that misses steps": (
        every_second_step, "contacts", "contact_FR: a threshold that lighter steps"),
    "all calves from another zero": (
        from_another_zero(0.3, "_calf"), "legs", "-0.3 rad added"),
    "all thighs from another zero": (
        from_another_zero(-0.2, "_thigh"), "legs", "+0.2 rad added"),
    "gyro late": (late(0.06, "gyro"), "reference's attitude", "gyro_x, gyro_y, gyro_z: a filter"),
    "a heading that turns clockwise": (
        euler_angles(lambda yaw, pitch, roll: (-yaw, pitch, roll)),
        "reference's attitude", "heading turns clockwise"),
    "roll and pitch swapped": (
        euler_angles(lambda yaw, pitch, roll: (yaw, roll, pitch)),
        "reference's attitude", "roll and pitch are exchanged"),
    "velocities in km/h": (times(3.6, "ref_v"), "reference's velocity", "in km/h"),
    "velocities in inches/s": (times(39.37, "ref_v"), "reference's velocity", "in inches/s"),
    "no velocity along an axis": (
        constant(0.0, "ref_v_x"), "frozen", "ref_v_x: a sensor that hangs"),
    "gyro held": (
        lambda log: edited(
            log, **{c: np.repeat(log.frame[c].to_numpy()[::4], 4)[: len(log.t)] for c in GYRO}
        ), "held", "gyro_x"),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_nonsense_is_noticed_by_the_right_name(log, name):
    change, rule, words = CASES[name]
    said = check_log(change(log), SPOT)
    for one in said:
        assert_pasteable(one)
    found = [f"{one.rule}: {one.line}" for one in said]
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


def turned(axis: str, degrees: float) -> Rotation:
    return Rotation.from_euler(axis, degrees, degrees=True)


def body_turned(axis: str, degrees: float) -> Callable[[Log], Log]:
    return attitude(lambda R: R * turned(axis, degrees))


ONE_CAUSE: dict[str, Callable[[Log], Log]] = {
    **{
        f"IMU turned by {degrees} deg about {axis}": imu_turned(turned(axis, degrees))
        for axis, degrees in (("x", 90), ("x", 180), ("y", -90), ("y", 180), ("z", 90), ("z", 180))
    },
    "IMU mirrored": exchanged(("gyro_y", "gyro_z"), ("accel_y", "accel_z")),
    **{
        f"tracked body turned by {degrees} deg about {axis}": body_turned(axis, degrees)
        for axis, degrees in (("x", 180), ("y", 90), ("z", 90), ("z", 180), ("z", 30))
    },
    "attitudes turned about z": attitude(lambda R: turned("z", 90) * R),
    "gyro in deg/s": times(DEGREE, "gyro"),
    "gyro negated": times(-1, "gyro"),
    "accelerometer in g": times(1 / 9.80665, "accel"),
    "accelerometer negated": times(-1, "accel"),
    "accelerometer's z negated": times(-1, "accel_z"),
    "calves reversed": times(-1, "q_", "dq_", "tau_", ends="_calf"),
    "one thigh reversed": times(-1, "q_", "dq_", "tau_", ends="FR_thigh"),
    "an angle reversed": times(-1, "q_FR_thigh"),
    "quaternions of the inverse": attitude(Rotation.inv),
}
"""One defect each."""


@pytest.mark.parametrize("name", ONE_CAUSE)
def test_one_cause_has_one_finding_and_what_it_says_to_paste_repairs(log, name):
    changed = ONE_CAUSE[name](without(log, "ref_v"))
    (found,) = check_log(changed, SPOT)
    assert found_in(pasted(changed, found.changes)) == []


@pytest.mark.parametrize(("leg", "lacks"), [("FL", "x_"), ("RR", "tau_")])
def test_a_hip_of_the_opposite_sign_shows_when_a_robot_walks_straight_ahead(ahead, leg, lacks):
    """It moves about 0 rad, so that standing feet hardly move."""
    changed = times(-1.0, "q_", "dq_", "tau_", ends=f"{leg}_hip")(ahead)
    (found,) = check_log(without(changed, lacks), SPOT)
    assert found.changes == {"robot": {"joint_sign": {f"{leg}_hip": -1.0}}}


WORLDS = {  # rotation to the recorded world -> rotation back to z up
    "y up": (turned("x", -90), turned("x", 90)),
    "y down": (turned("x", 90), turned("x", -90)),
    "x up": (turned("y", 90), turned("y", -90)),
    "z down": (NED, NED),
}


@pytest.mark.parametrize("seconds", [0.0, 0.4, -0.6])
@pytest.mark.parametrize("world", WORLDS)
def test_another_world_is_one_finding_on_another_clock_too(log, world, seconds):
    R_WG, R_GW = WORLDS[world]
    changed = attitude(lambda R: R_WG * R)(
        vectors(ref_p=R_WG.apply(log.ref_p))(without(log, "ref_v"))
    )
    changed = late(seconds, "ref_")(changed) if seconds > 0.0 else changed
    if seconds < 0.0:
        changed = late(-seconds, "gyro", "accel", "q_", "dq_", "tau_", "contact_")(changed)
    found = check_log(changed, SPOT)[0]
    advised = Rotation.from_quat(found.changes["reference"]["q_GW"], scalar_first=True)
    assert (advised.inv() * R_GW).magnitude() < 1e-5
    assert abs(found.changes["reference"].get("offset", 0.0) + 0.0) == pytest.approx(
        abs(seconds), abs=0.01
    )


def pasted(log: Log, changes: Changes) -> Log:
    """A log with the columns that an import would give with these changes of its map."""
    if "reference" in changes:
        back = Rotation.from_quat(changes["reference"]["q_IM"], scalar_first=True).inv()
        log = attitude(lambda R: R * back)(log)
    factors: dict[str, Any] = {
        f"{kind}_{joint}": {"sign": sign}
        for joint, sign in changes.get("robot", {}).get("joint_sign", {}).items()
        for kind in ("q", "dq", "tau")
    }
    unit = {"deg/s": 1 / DEGREE, "g": 9.80665}
    columns = {
        column: keys.get("sign", 1.0)
        * unit.get(keys.get("unit"), 1.0)
        * log.frame[keys.get("of", column)]
        for column, keys in (factors | {**changes.get("columns", {})}).items()
    }
    return edited(log, **columns)


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
        assert named(f"frozen: {name}", frozen(name)(log), None)
    both_rest = frozen("q_FL_calf")(log)
    rests = np.diff(both_rest.frame["q_FL_calf"], prepend=np.nan) == 0.0
    both_rest = edited(both_rest, dq_FL_calf=np.where(rests, 0.0, log.frame["dq_FL_calf"]))
    assert not named("frozen", both_rest, None)


def test_joints_of_which_one_alone_is_scaled_are_no_matter_of_the_clock(log):
    """One of two joints with 2.3 times its rate leaves the other, and the stamps, as they are."""
    two = log.frame[["t", "q_FL_calf", "q_FR_calf", "dq_FL_calf", "dq_FR_calf"]]
    (found,) = found_in(edited(replace(log, frame=two), dq_FR_calf=2.3 * two["dq_FR_calf"]), None)
    assert found.startswith("joint rates: dq_FR_calf: scaled")
    assert "gain = 0.43" in found


def test_few_spikes_of_a_short_log_of_an_arm_are_noticed(log):
    t = 0.01 * np.arange(400)
    q, rng = 0.3 * np.sin(2.0 * t), np.random.default_rng(0)
    rate = 0.6 * np.cos(2.0 * t) + rng.normal(0.0, 0.01, len(t))
    arm = Log(pd.DataFrame({"t": t, "q_elbow": q, "dq_elbow": rate}), Meta(rate=100.0), "arm")
    assert found_in(arm, None) == []
    rate[[50, 121, 200, 222, 301, 350]] += 3.0
    assert named("spikes: dq_elbow", edited(arm, dq_elbow=rate), None)


def test_forces_that_are_held_have_their_line_for_the_map(log):
    rng = np.random.default_rng(0)
    held = {f"force_{leg}_z": rng.uniform(0.0, 90.0, len(log.t)) for leg in log.legs}
    slow = {name: np.repeat(x[::10], 10)[: len(log.t)] for name, x in held.items()}
    flat = {f"force_{leg}_{axis}": 0.0 for leg in log.legs for axis in "xy"}
    assert any('held = ["force"]' in line for line in found_in(edited(log, **flat, **slow)))


def test_rates_that_leap_as_their_angle_does_are_no_spikes(log):
    """A foot that chatters on the ground turns its joint to and fro within four rows."""
    there = (log.t > 3.0) & (log.t < 3.05)
    rate = np.where(there, 12.0 * np.array([0.0, 1.0, 0.0, -1.0])[np.arange(len(log.t)) % 4], 0.0)
    turned = np.cumsum(rate) / log.meta.rate
    q, dq = log.frame["q_FL_calf"], log.frame["dq_FL_calf"]
    chatters = edited(log, q_FL_calf=q + turned, dq_FL_calf=dq + rate)
    assert found_in(chatters) == []
    garbled = edited(chatters, q_FL_calf=q)
    assert named("spikes: dq_FL_calf", garbled)


def test_coarse_readings_that_pass_by_zero_are_no_drop_outs():
    """At impacts a reading of 0.1 is as frequent as one of 0."""
    usual = np.random.default_rng(0).normal(5.0, 0.3, 4000).round(1)
    at = np.arange(10, 4000, 40)
    impacts, dropped = usual.copy(), usual.copy()
    impacts[at] = 0.1 * (np.arange(len(at)) % 5 - 2)
    dropped[at] = 0.0
    assert np.sum(impacts == 0.0) == 20
    assert _drop_outs(impacts) == 0
    assert _drop_outs(dropped) == len(at)


def test_a_joint_that_is_held_throughout_rests_and_one_whose_rate_moves_hangs(log):
    """Between two counts of its encoder a joint at rest stays for seconds."""
    count = 1.5e-3 * (np.sin(np.arange(len(log.t))) > 0.9)
    count[len(count) // 4 : len(count) // 2] = 0.0
    still = edited(log, q_FL_hip=count, dq_FL_hip=np.gradient(count, log.t))
    assert not named("frozen", still)
    for other in (edited(still, dq_FL_hip=log.frame["dq_FL_hip"]), without(still, "dq_")):
        held = edited(other, q_FL_hip=np.zeros(len(log.t)))
        assert named("frozen: q_FL_hip", held)


def test_axes_are_matched_whatever_their_order_sign_and_size():
    rng = np.random.default_rng(0)
    b = rng.normal(size=(400, 3)) * [1.0, 0.1, 3.0]
    a = np.column_stack([2.0 * b[:, 2], 0.5 * b[:, 1], -b[:, 0]]) + 5.0
    match = match_axes(a + 0.01 * rng.normal(size=a.shape), b)
    assert match.order == (2, 1, 0)
    assert match.wrong == (0, 2)
    assert match.words == "x is z, z is -x"
    np.testing.assert_allclose(match.scale, [2.0, 0.5, 1.0], rtol=0.02)
    assert match_axes(b, b).wrong == ()


@pytest.mark.parametrize("late", [-0.314, 0.0, 0.127])
def test_a_lag_is_found_between_samples(late):
    t = np.arange(0.0, 30.0, 0.02)

    def motion(at):
        return np.column_stack([np.sin(2 * at) + np.sin(3.1 * at), np.cos(1.3 * at)])

    found, alike = lag_of(motion(t - late), motion(t), 0.02, 1.0)
    assert found == pytest.approx(late, abs=2e-3)
    assert alike > 0.98


@pytest.mark.parametrize(
    ("window", "sign", "cause"),
    [
        (0.18, 1.0, "a slow filter, which inverts a vibration"),
        (0.01, 1.0, None),
        (0.01, -1.0, "wrong sign"),
    ],
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
    told = [one.cause for one in found if one.streams == ("dq_head",)]
    assert told == ([cause] if cause else [])


@pytest.mark.parametrize("rows", [1, 2, 5])
def test_a_log_of_some_rows_has_nothing_to_compare(log, rows):
    assert found_in(log.rows(slice(rows))) == []


def test_the_fewer_columns_a_rule_compares_the_earlier_it_is_asked():
    """And a symptom of several causes is asked about after these."""
    order = [rule.name for rule in RULES]
    for earlier, later in (
        ("rows", "joint rates"),
        ("gyro's unit", "gyro"),
        ("reference's attitude", "gyro"),
        ("joint rates", "legs"),
        ("legs", "joint range"),
    ):
        assert order.index(earlier) < order.index(later), (earlier, later)


def test_a_note_and_a_fault_of_a_stream_are_both_found(log):
    found = check_log(both(clipped("gyro_z"), exchanged(("gyro_x", "gyro_y")))(log), SPOT)
    assert {"saturated", "gyro"} <= {one.rule for one in found}


def test_every_rule_says_why():
    assert len({rule.name for rule in RULES}) == len(RULES)
    for row in rules_table():
        assert [*row] == ["Rule", *PARAGRAPHS]
        assert min(map(len, row.values())) > 2
        assert "{" not in "".join(row.values())


def test_rules_need_what_logs_have():
    """What no log has would always be missing, and the rule would never speak."""
    known = ["t", *(name for names in GROUPS.values() for name in names)]
    for rule in RULES:
        assert all(any(c.startswith(need) for c in known) for need in (*rule.needs, *rule.beside))
