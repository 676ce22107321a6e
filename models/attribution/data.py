"""Columns and parts of the logs that a trace uses, and the effects that can be identified."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from surefoot.models.attribution.evidence import LogUnderModel, all_keys, channels_of
from surefoot.models.attribution.noise_floor import NoiseFloor, ground_evenness
from surefoot.models.attribution.sensor_noise import reference_notes
from surefoot.models.residuals.binning import BIN, bin_mean, inner_bins
from surefoot.models.residuals.channels import CHANNELS, channels
from surefoot.sim.common.errors import unknown
from surefoot.sim.effects import known_effects
from surefoot.sim.log import Log

LACKING = ": not used, the log lacks "
"""Text of a note between a channel and the columns that it lacks."""
SPLIT_BLOCK = 4.0
"""Length of the blocks of which two are fitted on and the third reports [s]: a few strides."""
GAP = 0.05
"""Gap between these blocks, as a share of them, longer than residuals are correlated."""
FEWEST_BLOCKS = 9
"""Minimum number of blocks per log; in a short log, blocks and gaps are shortened."""
SHORTEST_FIXED_BLOCK = 1.5
"""Minimum length of these blocks of a machine on a fixed base [s]: some swings."""
SHORTEST_PART = 0.5
"""Minimum length of a part of the split [s], in residuals with a reference."""
SHORTEST, SHORTEST_FIXED = 11.5, 3.0
"""Minimum length of the logs [s]: a log of 12 s, whose ends have no residual; and of all logs of a
machine on a fixed base together, where every row is informative.
"""
SHORTEST_NEW = 1.0
"""Shortest of the runs that are compared with earlier ones, if the longest of them: some of the
windows in which torques are averaged [s].
"""
REACH = 0.5
"""Distance that a robot cannot move without stepping; contacts that never change are then dead [m].
"""
_TURNS = 0.02
"""Deviation of a gyro from which a body does not rest [rad/s]."""
_CONSTANT = 1e-6
"""Range of a reference that does not move [m, or of a quaternion]: motion capture has 1e-4."""
OF_FEET = ("imu", "contact", "reference")
"""Groups of columns, beside the feet, that a trace by feet alone reads."""


def readings(log: Log, by_feet: bool = False) -> Log:
    """Keep only the columns that a measured log could have, without contacts that never change;
    `by_feet`: of a machine that is known by its feet alone, without joints that nothing models.
    """
    joints = () if by_feet else ("q_", "dq_", "tau_")
    known = ("gyro_", "accel_", *joints, "contact_", "force_", "foot_", "ref_")
    if dead_contacts(log):
        known = tuple(name for name in known if name != "contact_")
    needs = [one.needs for one in channels().values()]
    needs += [kind.traced.needs for kind in known_effects().usable()[0].values()]
    known += tuple(name for of_one in needs for name in of_one if name.startswith("x_"))
    names = [n for n in log.frame if str(n) == "t" or str(n).startswith(known)]
    meta = replace(log.meta, scenario=None, seed=None, effects=(), versions={})
    return Log(log.frame.filter(items=names), meta, log.name)


def dead_contacts(log: Log) -> str:
    """Say which contacts never change although the robot walks; "" if all do, or if it rolls."""
    if not log.has("contact") or not log.has("reference"):
        return ""
    if log.contact.all() and log.has("q") and np.ptp(log.q, axis=0).max() > 2.0 * np.pi:
        return ""
    same = log.contact.all(axis=0) | ~log.contact.any(axis=0)
    carried = same.all() and np.ptp(log.ref_p[:, :2], axis=0).max() > REACH
    if not same.any() or not (np.count_nonzero(~same) >= 2 or carried):
        return ""
    names = ", ".join(f"contact_{log.legs[i]}" for i in np.flatnonzero(same))
    return f"contacts: not used, no change in {names} although the robot walks"


@dataclass(frozen=True)
class Split:
    """Masks (M,) of the bins used to fit and to report."""

    fit: np.ndarray
    report: np.ndarray


def split_of(cases: Sequence[LogUnderModel]) -> Split:
    """Split each log: every third block reports, so that both parts have all that a robot does. The
    ends of a log belong to neither.
    """
    fits, reports = [], []
    for case in cases:
        t = case.motion.t - case.motion.t[0]
        block = min(SPLIT_BLOCK, t[-1] / FEWEST_BLOCKS)
        if case.fixed:
            # Long enough for some windows over which torques are averaged.
            block = min(max(block, SHORTEST_FIXED_BLOCK), t[-1] / 3.0)
        block = max(block, 1e-9)
        phase = np.mod(t, 3.0 * block)
        used = inner_bins(case.motion.t)
        fits.append(used & (phase >= GAP * block) & (phase < 2.0 * block))
        reports.append(used & (phase >= 2.0 * block + GAP * block))
    return Split(np.concatenate(fits), np.concatenate(reports))


def untraceable_reason(cases: Sequence[LogUnderModel], split: Split, new: bool = False) -> str:
    """Say in one line why these logs cannot be traced; "" if they can.

    new: whether they are compared with earlier runs. Nothing is fitted to a part and checked on
    another then, and the least changes say how much short runs show.
    """
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
    spans = [float(case.motion.t[-1] - case.motion.t[0]) for case in cases]
    span, least = sum(spans), SHORTEST_FIXED if cases[0].fixed else SHORTEST
    if new and cases[0].fixed:
        span, least = max(spans), SHORTEST_NEW
    if span < least:
        # With the digits that show it.
        digits = next((k for k in range(1, 9) if f"{span:.{k}f}" != f"{least:.{k}f}"), 9)
        needed = f"{least:g} s are needed to fit and to check"
        more = "; several logs of one machine add up" if cases[0].fixed and not new else ""
        return f"too short: {span:.{digits}f} s where {needed}{more}"
    if new and cases[0].fixed:
        return ""
    known = np.concatenate([bin_mean(case.motion)(case.motion.ok.astype(float)) for case in cases])
    fit, report = (BIN * float(known[part].sum()) for part in (split.fit, split.report))
    if min(fit, report) < SHORTEST_PART:
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
    notes += _misnamed_channels()
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
        notes.append(
            "the reference's velocity is derived from its positions, which halves motions at 13 "
            "Hz; where the robot bounces faster than 8 Hz, delays, scales and hips may seem to err"
        )
        if floor.walks or by_feet:
            notes += [note for case in cases for note in reference_notes(case.log)]
    if not (floor.walks or fixed or by_feet):
        notes.append("the model does not walk in simulation: the floor is sensor noise alone")
    if (evenness := ground_evenness(cases)) and "foot_height" in there:
        notes.append(f"the ground is assumed even to {1e3 * evenness:.2g} mm (standard deviation)")
    robots = [case.robot.legged for case in cases]
    if any(robot is not None and np.any(robot.foot_radius == 0) for robot in robots):
        notes.append(
            "the model's feet are points; the walks of the noise floor have the feet of its file"
        )
    return tuple(notes)


def _misnamed_channels() -> list[str]:
    """A note for each effect that names a channel which does not exist, such as a misspelt one."""
    return [
        f"effect {name}: {unknown('channel', one, channels())}"
        for name, kind in known_effects().usable()[0].items()
        for one in kind.traced.channels
        if one not in channels()
    ]


def _notes_by_feet(cases: Sequence[LogUnderModel], of_joints: Sequence[str]) -> list[str]:
    """What a trace by feet alone assumes, and what it does without: channels `of_joints`, and
    effects.
    """
    effects = [
        name
        for name, kind in sorted(known_effects().usable()[0].items())
        if kind.is_compensated() and not kind.traced.on_given_feet
    ]
    needing = "since they need joint angles and a robot model"
    notes = [
        "the legs are known by the positions of their feet, which are taken for points: each may "
        "roll or creep by a share of its way, which every fit includes; foot_creep and foot_scrub "
        "are what all of them together lose",
        f"channels not used, {needing}: {', '.join(of_joints)}",
        f"effects not tried, {needing}: {', '.join(effects)}",
    ]
    if any(case.log.has("force") or case.log.has("force_xyz") for case in cases):
        notes.append("forces of the feet: not used, their sum needs the robot's mass")
    return notes


def _not_identifiable(cases: Sequence[LogUnderModel]) -> list[str]:
    """One sentence for each effect that cannot be identified without a reference, and could be with
    one."""
    candidates = {name for case in cases for name, _ in all_keys(case)}
    lacking = {
        name: {g for case in cases for g in channel.missing_groups(case.log, case.fixed)}
        for name, channel in channels().items()
    }
    notes = []
    for name, kind in sorted(known_effects().usable()[0].items()):
        needs = [one for one in kind.traced.channels if lacking.get(one) == {"reference"}]
        if kind.is_compensated() and name not in candidates and needs:
            notes.append(
                f"{name}: not identifiable without a reference; it shows in {' and '.join(needs)}"
            )
    return notes
