"""Columns of a recording become a Log, as an import map says (`sim.importing.map`)."""

from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
import pandas as pd

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.quaternion import matrix_from_quaternion, quaternion_from_matrix
from surefoot.sim.importing.map import ImportMap
from surefoot.sim.log import Log, LogError, Meta
from surefoot.sim.log.schema import check_frame, joint_names, joint_prefix
from surefoot.sim.sensors.contact import contact_from_force

MAX_GAP = 0.05
"""s. Over a longer gap in the reference, rows are interpolated and marked with ref_ok = 0."""
_UNIT_TOLERANCE = 1e-2

Columns = dict[str, np.ndarray]


def checked_log(main: Columns, reference: Columns | None, rules: ImportMap, path: Path) -> Log:
    """The log of tables in SI units, every column checked. Raises LogError naming path and map."""
    if "ref_q_w" in main:
        unit_quaternions(path, main)
    log = log_from_tables(main, reference, rules, path.stem)
    try:
        check_frame(log.frame, log.rate)
    except SurefootError as error:
        raise LogError(f"{path} as {rules.path}: {error}") from error
    return log


def log_from_tables(main: Columns, reference: Columns | None, rules: ImportMap, name: str) -> Log:
    """Assemble a Log from tables of log columns in SI units, each (N,), one row a sample.

    `main` has `t` unless the map gives a rate; `reference` has its own `t`, ref_p and ref_q.
    """
    main = dict(main)
    if rules.rate is not None:
        rows = len(next(iter(main.values())))
        main = {"t": np.arange(rows) / rules.rate, **main}
        rate = rules.rate
    else:
        rate = float(f"{1.0 / np.median(np.diff(main['t'])):.6g}") if len(main["t"]) > 1 else 1.0
    _apply_joints(main, rules)
    derived = []
    if rules.contact is not None:
        derived.append("contact from force")
        for leg in rules.contact.on:
            main[f"contact_{leg}"] = contact_from_force(
                main["t"],
                main[f"force_{leg}"] - rules.contact.offset[leg],
                rules.contact.on[leg],
                rules.contact.off[leg],
                rules.contact.debounce,
            ).astype(float)
    if reference is not None:
        main = _with_reference(main, reference, rules)
    joints = joint_names(main)
    law = _motor_law(rules, joints)
    torques = _torques_by_law(main, joints, law)
    if torques:
        main |= torques
        derived.append("tau (motor law)")
    frame = pd.DataFrame({column: main[column] for column in sorted(main, key=_column_order)})
    meta = Meta(
        rate=rate,
        robot=rules.robot,
        motor_law=law,
        derived=tuple(derived),
        versions=_versions(),
        model=rules.model,
    )
    return Log(frame, meta, name)


def interpolate_reference(
    t: np.ndarray, reference_t: np.ndarray, p: np.ndarray, q: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Poses at t (N,) from poses at reference_t (M,): p (M, 3) linearly, q (M, 4) by slerp.

    Returns p (N, 3), unit q (N, 4) and ok (N,): False strictly inside a gap over MAX_GAP. All t
    lie within the reference.
    """
    after = np.clip(np.searchsorted(reference_t, t, side="left"), 1, len(reference_t) - 1)
    before = after - 1
    gap = reference_t[after] - reference_t[before]
    share = ((t - reference_t[before]) / gap)[:, None]
    ok = (gap <= MAX_GAP) | (t == reference_t[before]) | (t == reference_t[after])
    position = (1.0 - share) * p[before] + share * p[after]
    start, end = q[before], q[after]
    cosine = np.sum(start * end, axis=1, keepdims=True)
    end = np.where(cosine < 0.0, -end, end)
    # atan2 of half the chord keeps its digits where the angle is small.
    angle = 2.0 * np.arctan2(
        np.linalg.norm(end - start, axis=1), np.linalg.norm(end + start, axis=1)
    )
    angle = angle[:, None]
    apart = angle > 1e-9
    sine = np.sin(np.where(apart, angle, 1.0))
    first = np.where(apart, np.sin((1.0 - share) * angle) / sine, 1.0 - share)
    second = np.where(apart, np.sin(share * angle) / sine, share)
    attitude = first * start + second * end
    return position, attitude / np.linalg.norm(attitude, axis=1, keepdims=True), ok


def _with_reference(main: Columns, reference: Columns, rules: ImportMap) -> Columns:
    t = main["t"]
    inside = (t >= reference["t"][0]) & (t <= reference["t"][-1])
    if not inside.any():
        raise SurefootError(
            f"{rules.path}: the reference ({reference['t'][0]:.6g} to {reference['t'][-1]:.6g} s)"
            f" and the recording ({t[0]:.6g} to {t[-1]:.6g} s) do not overlap"
        )
    main = {column: values[inside] for column, values in main.items()}
    p, q, ok = interpolate_reference(
        main["t"],
        reference["t"],
        np.column_stack([reference[f"ref_p_{axis}"] for axis in "xyz"]),
        np.column_stack([reference[f"ref_q_{axis}"] for axis in "wxyz"]),
    )
    if rules.reference is not None and rules.reference.frame == "base":
        p, q = _base_to_imu(p, q, rules)
    main |= {f"ref_p_{axis}": p[:, i] for i, axis in enumerate("xyz")}
    main |= {f"ref_q_{axis}": q[:, i] for i, axis in enumerate("wxyz")}
    main["ref_ok"] = ok.astype(float)
    return main


def _base_to_imu(p: np.ndarray, q: np.ndarray, rules: ImportMap) -> tuple[np.ndarray, np.ndarray]:
    if "p_BI" not in rules.model:
        raise SurefootError(f'{rules.path}: [reference] frame "base" needs [robot] imu_position')
    R_GB = matrix_from_quaternion(q)
    R_BI = matrix_from_quaternion(np.array(rules.model.get("q_BI", [1.0, 0.0, 0.0, 0.0])))
    return p + R_GB @ np.array(rules.model["p_BI"]), quaternion_from_matrix(R_GB @ R_BI)


def check_rising(t: np.ndarray, path: Path, column: str, unit: str, first: int) -> None:
    """Raise LogError at the first time that does not come after the one before it.

    Args:
        t: (N,) [s].
        path: of the file, for the message.
        column: its column, for the message.
        unit: name of a row in the message: "line", "message".
        first: number of the first row.
    """
    bad = np.flatnonzero(np.diff(t) <= 0.0)
    if bad.size:
        row = int(bad[0]) + 1
        how = "duplicate stamp" if t[row] == t[row - 1] else "jumps back"
        raise LogError(
            f"{path}: column {column!r}, {unit} {row + first}: {how},"
            f" {t[row - 1]:.9g} s then {t[row]:.9g} s"
        )


def unit_quaternions(path: Path, table: Columns) -> None:
    """Normalise decimals to unit length; raise where they were never a rotation."""
    q = np.column_stack([table[f"ref_q_{axis}"] for axis in "wxyz"])
    norm = np.linalg.norm(q, axis=1)
    bad = np.flatnonzero(np.abs(norm - 1.0) > _UNIT_TOLERANCE)
    if bad.size:
        row = int(bad[0])
        raise LogError(f"{path}: line {row + 2}: not a unit quaternion (norm {norm[row]:.6g})")
    for i, axis in enumerate("wxyz"):
        table[f"ref_q_{axis}"] = q[:, i] / norm


def _apply_joints(main: Columns, rules: ImportMap) -> None:
    joints = joint_names(main)
    for joint in (*rules.joint_sign, *rules.joint_offset):
        if joint not in joints:
            raise SurefootError(f"{rules.path}: [robot] joint {joint!r} has no column q_{joint}")
    for column in main:
        prefix = joint_prefix(column)
        if prefix is not None:
            joint = column.removeprefix(prefix)
            main[column] = rules.joint_sign.get(joint, 1.0) * main[column]
            if prefix in ("q_", "q_des_"):
                main[column] = main[column] + rules.joint_offset.get(joint, 0.0)


def _motor_law(rules: ImportMap, joints: tuple[str, ...]) -> dict[str, list[float]] | None:
    if rules.motor_law is None:
        return None
    law: dict[str, list[float]] = {}
    for key, gains in rules.motor_law.items():
        if isinstance(gains, dict):
            if set(gains) != set(joints):
                odd = sorted(set(gains) ^ set(joints))[0]
                raise SurefootError(
                    f"{rules.path}: [motor_law] {key}: joint {odd!r} is odd one out"
                )
            law[key] = [gains[joint] for joint in joints]
        else:
            law[key] = [gains] * len(joints)
    return law


def _torques_by_law(
    main: Columns, joints: tuple[str, ...], law: dict[str, list[float]] | None
) -> Columns:
    """tau = kp (q_des - q) + kd (dq_des - dq) + tau_ff [N m], where a log has positions, rates and
    targets but no torque of its own; targets that it lacks are zero, as the law has them."""
    if law is None or any(f"tau_{joint}" in main for joint in joints):
        return {}
    if not all(f"{kind}_{joint}" in main for joint in joints for kind in ("dq", "q_des")):
        return {}
    return {
        f"tau_{joint}": kp * (main[f"q_des_{joint}"] - main[f"q_{joint}"])
        + kd * (main.get(f"dq_des_{joint}", 0.0) - main[f"dq_{joint}"])
        + main.get(f"tau_ff_{joint}", 0.0)
        for joint, kp, kd in zip(joints, law["kp"], law["kd"], strict=True)
    }


_ORDER = ("t", "gyro", "accel", "q_", "dq_", "tau_", "contact", "force", "ref", "x_")


def _column_order(column: str) -> int:
    """Groups in the order of the Log's table; `sorted` keeps the map's order within one."""
    prefix = joint_prefix(column) or column
    matches = [i for i, start in enumerate(_ORDER) if prefix.startswith(start)]
    return 0 if column == "t" else max(matches, default=len(_ORDER))


def _versions() -> dict[str, str]:
    try:
        return {"surefoot": version("surefoot")}
    except PackageNotFoundError:
        return {"surefoot": "source"}
