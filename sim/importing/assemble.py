"""Assemble a Log from the columns of a recording, by an import map (`sim.importing.map`)."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from surefoot.sim.common.errors import SurefootError, errors_in
from surefoot.sim.common.limits import check_limit
from surefoot.sim.importing.clock import Columns, column_kind, resampled, usual_rate, without_holds
from surefoot.sim.importing.contacts import feet_that_stand
from surefoot.sim.importing.map import ImportMap
from surefoot.sim.importing.reference import (
    REFERENCE_OFFSET,
    REFERENCE_SAMPLES,
    imu_poses,
    reference_offset,
    unit_quaternions,
    with_reference,
)
from surefoot.sim.importing.reference_check import contradicted
from surefoot.sim.importing.sections import EvenTable, by_name
from surefoot.sim.log import Log, LogError, Meta
from surefoot.sim.log.reference import Poses
from surefoot.sim.log.schema import GROUPS, check_frame, joint_names, joint_prefix

_QUATERNION = GROUPS["reference"][3:]


@dataclass(frozen=True)
class RawRecording:
    """A recording read by a map, before it is converted to a log.

    Attributes:
        main: log columns in SI units, each (N,), including `t`.
        poses: of a reference with its own clock, as recorded; else None.
        rules: the map.
        path: the main file.
        notes: sentences for the user on how it was read.
    """

    main: Columns
    poses: Poses | None
    rules: ImportMap
    path: Path
    notes: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Name of the recording: that of its file, without the suffix."""
        return self.path.stem

    def reference(self) -> tuple[Poses, np.ndarray] | tuple[None, None]:
        """K poses of the IMU frame on the log's clock, and a mask (K,) of those that the IMU
        contradicts.

        The log omits the latter. Both are None without a reference with its own clock.
        """
        if self.poses is None:
            return None, None
        poses = imu_poses(self.poses, self.rules, self.name)
        if not {"t", *GROUPS["imu"]} <= set(self.main):
            return poses, np.zeros(len(poses.t), dtype=bool)
        columns = np.column_stack([self.main[name] for name in GROUPS["imu"]])
        return poses, contradicted(self.main["t"], columns[:, :3], columns[:, 3:], poses)

    def without_reference(self) -> "RawRecording":
        """The recording with all its rows, but without its reference."""
        return replace(self, poses=None)

    def with_reference(self, values: Mapping[str, Any]) -> "RawRecording":
        """The recording, with other values of its map's [reference]."""
        assert self.rules.sections.reference is not None
        reference = replace(self.rules.sections.reference, **values)
        sections = replace(self.rules.sections, reference=reference)
        return replace(self, rules=replace(self.rules, sections=sections))

    def log(self) -> Log:
        """Assemble the log and check every column. Raises LogError naming path and map."""
        rules, sections, derived = self.rules, self.rules.sections, list[str]()
        main, late_contacts = dict(self.main), dict[str, float]()
        if "ref_q_w" in main:
            q = np.column_stack([main[name] for name in _QUATERNION])
            main |= zip(_QUATERNION, unit_quaternions(self.path, q).T, strict=True)
        main = _with_joint_signs(main, rules)
        if even := sections.even:
            # Contacts may be found below, in columns that are in time.
            late_contacts = {k: x for k, x in even.late.items() if column_kind(k) == "contact"}
            others = {k: x for k, x in even.late.items() if k not in late_contacts}
            main, derived = _made_even(main, replace(even, late=others))
        model, (poses, wrong) = rules.model, self.reference()
        if poses is not None and wrong is not None:
            main = with_reference(main, poses.rows(~wrong), str(rules.path))
            offset = reference_offset(rules, self.name)
            model = model | ({REFERENCE_OFFSET: offset} if offset else {})
            step = round(1.0 / usual_rate(poses.t), 6)
            model = model | {REFERENCE_SAMPLES: [round(float(poses.t[0]), 6), step]}
        joints = joint_names(main)
        law = _motor_law(rules, joints)
        if torques := _torques_by_law(main, joints, law):
            main |= torques
            derived.append("tau (motor law)")
        frame = pd.DataFrame(main)
        meta = Meta(
            rate=sections.source.rate or usual_rate(main["t"]),
            robot=rules.robot,
            motor_law=law,
            derived=tuple(derived),
            versions={"surefoot": version("surefoot")},
            model=model,
        )
        log = Log(frame, meta, self.name)
        if sections.contact is not None:
            log = feet_that_stand(log, sections.contact)
        if late_contacts:
            log = _with_contacts_forward(log, late_contacts)
        try:
            check_frame(log.frame, log.rate)
        except SurefootError as error:
            raise LogError(f"{self.path} as {rules.path}: {error}") from error
        return log


def _with_contacts_forward(log: Log, delays: Mapping[str, float]) -> Log:
    """The log with its contacts, all or of single legs, earlier by their delays [s]."""
    _check_known("late", delays, log.columns)
    frame = pd.DataFrame(resampled(log.columns, log.t, delays))
    meta = replace(log.meta, derived=(*log.meta.derived, *_earlier_words(delays)))
    return replace(log, frame=frame, meta=meta)


def _earlier_words(delays: Mapping[str, float]) -> list[str]:
    return [f"{kind} ({1e3 * delay:g} ms earlier)" for kind, delay in delays.items()]


def _check_known(key: str, named: Iterable[str], columns: Iterable[str]) -> None:
    """Raise SurefootError where a key of [even] names neither a column nor a kind of them."""
    kinds = {column_kind(name) for name in columns}
    known = kinds if key == "held" else {*kinds, *columns}
    for kind in named:
        if kind not in known:
            raise SurefootError(
                f"[even] {key}: no column of kind {kind!r}; there are {', '.join(sorted(kinds))}"
            )


def _made_even(main: Columns, even: EvenTable) -> tuple[Columns, list[str]]:
    """Interpolate held columns and resample to an even rate; also returns the names of derived
    ones.
    """
    _check_known("held", even.held, main)
    _check_known("late", even.late, main)
    said = [f"{kind} (between held readings)" for kind in even.held]
    said += _earlier_words(even.late)
    t = main["t"]
    rate = even.rate or usual_rate(t)
    size = 8.0 * len(main) * rate * (t[-1] - t[0])
    check_limit("memory", size, f"[even] at {rate:g} Hz: bytes in memory")
    times = np.arange(t[0], t[-1] + 1e-9, 1.0 / rate)
    main = resampled(without_holds(main, even.held), times, even.late)
    return main, [*said, f"rows at {rate:g} Hz"]


def _with_joint_signs(main: Columns, rules: ImportMap) -> Columns:
    """The columns with the signs and offsets of [robot], and the torques of its passive joints."""
    main, robot = dict(main), rules.sections.robot
    if robot is None:
        return main
    joints = joint_names(main)
    for joint in (*robot.joint_sign, *robot.joint_offset, *robot.passive):
        if joint not in joints:
            raise SurefootError(f"{rules.path}: [robot] joint {joint!r} has no column q_{joint}")
    for column in main:
        prefix = joint_prefix(column)
        if prefix is not None:
            joint = column.removeprefix(prefix)
            main[column] = robot.joint_sign.get(joint, 1.0) * main[column]
            if prefix in ("q_", "q_des_"):
                main[column] = main[column] + robot.joint_offset.get(joint, 0.0)
    for kind in ("tau", "tau_ff"):
        without = [joint for joint in joints if f"{kind}_{joint}" not in main]
        if len(without) == len(joints):
            continue
        if driven := [joint for joint in without if joint not in robot.passive]:
            raise SurefootError(
                f"{rules.path}: [columns] {kind}_{driven[0]} is missing; "
                "name joints without a drive under [robot] passive"
            )
        main |= {f"{kind}_{joint}": np.zeros(len(main["t"])) for joint in without}
    return main


def _motor_law(rules: ImportMap, joints: tuple[str, ...]) -> dict[str, list[float]] | None:
    given = rules.sections.motor_law
    if given is None:
        return None
    with errors_in(str(rules.path)):
        gains = {key: by_name(f"motor_law.{key}", one, joints) for key, one in vars(given).items()}
    return {key: [by_joint[joint] for joint in joints] for key, by_joint in gains.items()}


def _torques_by_law(
    main: Columns, joints: tuple[str, ...], law: dict[str, list[float]] | None
) -> Columns:
    """tau = kp (q_des - q) + kd (dq_des - dq) + tau_ff [N m], if a log has positions, rates and
    targets but no torque. Missing rate targets and feed-forward torques are zero.
    """
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
