"""Columns that a trace reads from its logs, and the effects that can be identified from them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from surefoot.models.attribution.evidence import LogUnderModel, all_keys, channels_of
from surefoot.models.attribution.noise_floor import NoiseFloor
from surefoot.models.attribution.reference_sampling import reference_notes, reference_sampling
from surefoot.models.attribution.settings import DEFAULT, TraceSettings
from surefoot.models.attribution.split import Split
from surefoot.models.residuals.binning import BIN, bin_mean
from surefoot.models.residuals.channels import CHANNELS, channels
from surefoot.sim.effects import known_effects
from surefoot.sim.log import Log

LACKING = ": not used, the log lacks "
"""Text of a note between a channel and the columns that it lacks."""
_TURNS = 0.02
"""Deviation of a gyro from which a body does not rest [rad/s]."""
_CONSTANT = 1e-6
"""Range of a reference that does not move [m, or of a quaternion]: motion capture has 1e-4."""
OF_FEET = ("imu", "contact", "reference")
"""Groups of columns, beside the feet, that a trace by feet alone reads."""


def _too_short(seconds: float, least: float) -> str:
    """State that a log is too short, with the digits that show it."""
    digits = next((k for k in range(1, 9) if f"{seconds:.{k}f}" != f"{least:.{k}f}"), 9)
    return f"too short: {seconds:.{digits}f} s where {least:g} s"


def readings(log: Log, settings: TraceSettings = DEFAULT, by_feet: bool = False) -> Log:
    """Keep only the columns that a measured log could have, without contacts that never change;
    `by_feet`: of a machine that is known by its feet alone, without joints that nothing models.
    """
    joints = () if by_feet else ("q_", "dq_", "tau_")
    known = ("gyro_", "accel_", *joints, "contact_", "force_", "foot_", "ref_")
    if dead_contacts(log, settings):
        known = tuple(name for name in known if name != "contact_")
    read_by = (*channels().values(), *known_effects().usable()[0].values())
    known += tuple(n for one in read_by for n in one.needs if n.startswith("x_"))
    names = [n for n in log.frame if str(n) == "t" or str(n).startswith(known)]
    meta = replace(log.meta, scenario=None, seed=None, effects=(), versions={})
    return Log(log.frame.filter(items=names), meta, log.name)


def dead_contacts(log: Log, settings: TraceSettings = DEFAULT) -> str:
    """Say which contacts never change although the robot walks; "" if all do, or if it rolls."""
    if not log.has("contact") or not log.has("reference"):
        return ""
    if log.contact.all() and log.has("q") and np.ptp(log.q, axis=0).max() > 2.0 * np.pi:
        return ""
    legs = log.legs
    dead = [leg for leg, one in zip(legs, log.contact.T, strict=True) if one.all() or not one.any()]
    far = float(np.ptp(log.ref_p[:, :2], axis=0).max())
    carried = len(dead) == len(legs) and far > settings.reach_without_step
    walks = len(legs) - len(dead) >= 2 or carried
    if not dead or not walks:
        return ""
    names = ", ".join(f"contact_{leg}" for leg in dead)
    return f"contacts: not used, no change in {names} although the robot walks"


def untraceable_reason(cases: Sequence[LogUnderModel], split: Split) -> str:
    """Say in one line why these logs cannot be traced; "" if they can."""
    if not any(all_keys(case) for case in cases):
        groups = ("imu", "q", "contact", "tau", "reference")
        lacking = [g for g in groups if not all(case.log.has(g) for case in cases)]
        if cases[0].by_feet:
            return (
                f"no channel: the log lacks {', '.join(g for g in lacking if g in OF_FEET)}; feet "
                "without a robot model need a reference, beside imu or contact: how far they roll "
                "is not known, and without a reference looks like a scale of the gyro"
            )
        return (
            f"no channel: the log lacks {', '.join(lacking)}; needs imu, or q and contact, beside "
            "the reference; without one imu, q and contact; or q and tau of a fixed base"
        )
    s = cases[0].settings
    spans = [float(case.motion.t[-1] - case.motion.t[0]) for case in cases]
    needed = "are needed to fit and to check"
    if cases[0].fixed and sum(spans) < s.shortest_fixed_log:
        more = "several logs of one machine add up"
        return f"{_too_short(sum(spans), s.shortest_fixed_log)} {needed}; {more}"
    if not cases[0].fixed and sum(spans) < s.shortest_log:
        return f"{_too_short(sum(spans), s.shortest_log)} {needed}"
    known = np.concatenate([bin_mean(case.motion)(case.motion.ok.astype(float)) for case in cases])
    fit, report = (BIN * float(known[part].sum()) for part in (split.fit, split.report))
    if min(fit, report) < s.shortest_part:
        return f"too little reference: {fit:.1f} s to fit on, {report:.1f} s to report on"
    return next((why for case in cases if not case.fixed and (why := _frozen(case.log))), "")


def _frozen(log: Log) -> str:
    """Say which part of a log's reference never changes although the body turns; "" if none."""
    turns = float(log.gyro.std(axis=0).max()) if log.has("imu") else 0.0
    if turns < _TURNS or not log.has("reference"):
        return ""
    for name, values in {"ref_p": log.ref_p, "ref_q": log.ref_q}.items():
        if np.ptp(values[log.ref_ok], axis=0).max() < _CONSTANT:
            return (
                f"{name} never changes while the gyro does, by {turns:.2g} rad/s "
                "(standard deviation): no reference was measured; leave the columns ref_ out"
            )
    return ""


def data_notes(cases: Sequence[LogUnderModel], floor: NoiseFloor) -> tuple[str, ...]:
    """Notes on the data, for the reader of the result."""
    plugins = (known_effects(), CHANNELS)
    notes = [f"{why}; not used" for one in plugins for why in one.usable()[1].values()]
    there = set.intersection(*(set(channels_of(case)) for case in cases))
    fixed, by_feet = cases[0].fixed, cases[0].by_feet
    of_joints: list[str] = []
    for name, channel in channels().items():
        if name in there or (fixed and not channel.on_fixed_base):
            continue
        lacking = dict.fromkeys(
            g for case in cases for g in channel.missing_groups(case.log, fixed, case.by_feet)
        )
        if by_feet and not channel.on_given_feet:
            of_joints.append(name)
        elif lacking:
            notes.append(f"{name}{LACKING}{' and '.join(lacking)}")
        elif channel.on_level_ground:
            notes.append(f"{name}: not used, the ground is not level")
    if by_feet:
        notes += _notes_by_feet(cases, of_joints)
    elif any(case.log.has("foot") and not case.log.has("q") for case in cases):
        notes.append(
            "legs: not traced, since foot positions do not show the joints; the log lacks q"
        )
    if "joint_torque" not in there and all(case.log.has("q_des") for case in cases):
        notes.append(
            "tracking: commanded angles need a motor law to give torques; add one to the map"
        )
    if fixed:
        notes.append("without a reference, the base is assumed to be at rest and level")
        if any(case.motion.rates_of_angles for case in cases):
            notes.append(
                "torques: joint rates are derived from the angles, which are less noisy than the "
                "logged rates"
            )
    elif not all(case.log.has("reference") for case in cases):
        notes.append(
            "without a reference, feet in stance are compared with each other, and each joint with "
            "itself"
        )
        notes += _not_identifiable(cases)
    elif not all(case.log.has("ref_v") for case in cases):
        notes.append("the reference's velocity is derived from its positions, which smooths it")
        for case in cases:
            sampling = floor.plan.sampling if floor.plan else None
            if case.by_feet:
                sampling = reference_sampling(case.log, case.settings)
            notes += reference_notes(case.log, sampling)
    if not (floor.walks or fixed or by_feet):
        notes.append("the model does not walk in simulation: the floor is sensor noise alone")
    if floor.evenness and "foot_height" in there:
        notes.append(
            f"the ground is assumed even to {1e3 * floor.evenness:.2g} mm (standard deviation)"
        )
    robots = [case.robot.legged for case in cases]
    if any(robot is not None and np.any(robot.foot_radius == 0) for robot in robots):
        notes.append(
            "the model's feet are points; the walks of the noise floor have the feet of its file"
        )
    return tuple(notes)


def _notes_by_feet(cases: Sequence[LogUnderModel], of_joints: Sequence[str]) -> list[str]:
    """What a trace by feet alone assumes, and what it does without: channels `of_joints`, and
    effects.
    """
    effects = [
        name
        for name, kind in sorted(known_effects().usable()[0].items())
        if kind.is_compensated() and not kind.on_given_feet
    ]
    needing = "since they need joint angles and a robot model"
    notes = [
        "the legs are known by the positions of their feet, which are taken for points: each may "
        "roll or creep by a share of its way, which is fitted and not reported",
        f"channels not used, {needing}: {', '.join(of_joints)}",
        f"effects not tried, {needing}: {', '.join(effects)}",
    ]
    if any(case.log.has("force") or case.log.has("force_xyz") for case in cases):
        notes.append("forces of the feet: not used, their sum needs the robot's mass")
    return notes


def _not_identifiable(cases: Sequence[LogUnderModel]) -> list[str]:
    """One sentence for each effect that cannot be identified without a reference, and could be with
    one."""
    told = {name for case in cases for name, _ in all_keys(case)}
    lacking = {
        name: {g for case in cases for g in channel.missing_groups(case.log, case.fixed)}
        for name, channel in channels().items()
    }
    notes = []
    for name, kind in sorted(known_effects().usable()[0].items()):
        needs = [one for one in kind.channels if lacking.get(one) == {"reference"}]
        if kind.is_compensated() and name not in told and needs:
            notes.append(
                f"{name}: not identifiable without a reference; it shows in {' and '.join(needs)}"
            )
    return notes
