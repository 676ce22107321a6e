"""Checks of leg kinematics against the body's motion: swapped legs and joints, signs, zeros,
delays.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import permutations, product

import numpy as np

from surefoot.sim.plausibility.finding import Finding, plausibility_rule
from surefoot.sim.plausibility.limits import FEWEST, LATE, LATE_STREAM, LATEST_STREAM, MENDED
from surefoot.sim.plausibility.loads import exchanged, leaning
from surefoot.sim.plausibility.stance import Stance
from surefoot.sim.plausibility.view import STEP, LogView

MISFIT = 0.01
"""Mean squared velocity of standing feet, relative to the body's, without the worst tenth: 0.006 in
clean simulated walks, 0.03 to 0.1 on a measured Go1. Below it nothing is reported.
"""
MENDED_JOINTS = 0.5
"""MENDED for signs and order of joints, with more alternatives: 2.2 times, but for hips of robots
that walk straight ahead, 1.2 times, see LEANS.
"""
CLEARER = 0.9
"""Improvement required over an alternative that exchanges fewer legs, which is tried first."""
LEANS = 0.06
"""Sideways part of a leg's load by its torques from which the hip may have the opposite sign: 0.05
at most in clean walks of eleven robots, 0.08 to 0.7 with that sign.
"""
OFFSETS = np.outer(np.arange(2, 9) / 10.0, [1.0, -1.0]).ravel()
"""Offsets of joints that are tried [rad]: an encoder's zero is set to some degrees."""
DUTY = 0.48
"""Mean duty factor: half and more in walks and trots."""
HOPELESS = 0.6
"""Misfit from which the legs do not measure the body's motion at all, and no alternative corrects
it.
"""
SIZE = (0.65, 1.5)
"""Ratio of the velocity by the legs to the body's: 0.76 to 1.05 for rolling and compliant legs."""
LATEST_LEGS = 1.0
"""Largest delay of the legs that is searched for [s]: two strides."""
CLIMBS = 0.15
"""Climbing rate of a reference relative to the standing feet [m/s]: stairs at 0.5 m/s climb by 0.3,
rolling and compliant feet appear to by some hundredths.
"""
_TURNING = 0.5
"""Quantile of the gyro above which rows are used: legs differ where the body rotates."""
_MOVES = 0.1
"""Speed of the body below which nothing is compared [m/s]."""
_TRIED = 600
"""Number of times at which alternatives of joints are tried."""


def misfits(legs: Stance) -> np.ndarray:
    """Mean squared errors (1 + L,) of the velocity by all legs together, and by each, relative to
    the body's, without the worst tenth.

    NaN where too few feet stand. Without a reference, the legs are compared with their mean.
    """
    by_leg, v_I, on, fewest = legs.by_leg, legs.v_I, legs.contact & legs.used[:, None], FEWEST
    if not legs.has_truth:
        # Swinging feet also move together, so that some strides are needed.
        on, fewest = on & (on.sum(axis=1, keepdims=True) > 1), 2 * FEWEST
        count = np.maximum(on.sum(axis=1, keepdims=True), 1)
        v_I = np.sum(np.where(on[:, :, None], by_leg, 0.0), axis=1) / count
    on = on & (np.linalg.norm(v_I, axis=1) > _MOVES)[:, None]
    missed = np.sum((by_leg - v_I[:, None]) ** 2, axis=2)
    size = np.broadcast_to(np.sum(v_I**2, axis=1)[:, None], on.shape)
    found = []
    for some in (slice(None), *(slice(i, i + 1) for i in range(on.shape[1]))):
        at = on[:, some]
        most = np.sort(missed[:, some][at])[: int(0.9 * at.sum())]
        found.append(most.mean() / size[:, some][at].mean() if at.sum() >= fewest else np.nan)
    return np.array(found)


@plausibility_rule("legs", "t gyro contact", beside="q ref foot")
def kinematics(view: LogView) -> Iterator[Finding]:
    """Check that all legs in contact and the reference agree on the body's velocity.

    Compares: the velocity that the body has if feet in contact stand, leg by leg, with that of
        the reference (of each other without one): as they are, with legs exchanged, joints
        exchanged or of opposite sign, contacts inverted; all, one leg or contacts alone late;
        angles of most legs from another zero; the reference's vertical velocity with that of
        standing feet.
    Threshold: a correction that leaves {MENDED:g} of the mean square (joints {MENDED_JOINTS:g});
        {CLEARER:g} for a sign with which torques, which else push to a side by {LEANS:g} of the
        leg's load, do so half as much; {HOPELESS:.0%} of the body's own; not {SIZE[0]:g} to
        {SIZE[1]:g} times as fast; {CLIMBS:g} m/s upwards or downwards in the median.
    Reason: standing feet stand: 0.6 % in simulated walks, 3 to 10 % on a measured Go1, where
        each wrong reading has 1.66 times as much at least; legs that roll and give are 0.76 to
        1.05 times as fast; zeros are set to some degrees.
    Remedy: order or sign of the columns, joint_sign, joint_offset, the robot's name; another
        reference, or its world made level with [reference] q_GW.
    """
    legs = view.stance
    if legs is None or len(view.log.legs) < 2:
        return
    few = _few(legs)
    misfit = misfits(few)[0] > MISFIT
    found = _late(view, legs) if misfit and legs.has_truth else []
    found = found or _put_right(view, few, misfit)
    if legs.has_truth:
        found = found or _late_parts(view, legs)
        found = found or (_of_another_robot(few) if misfit else [])
        found = found or _climbing(view, legs)
        found = found or (_zeros(view, few) if misfit else [])
    yield from found


def _late(view: LogView, legs: Stance) -> list[Finding]:
    """Find a delay of joints and contacts together relative to gyro and reference."""
    lag, share = _lags(partial(_with_earlier_motion, view, legs), LATEST_LEGS)
    if abs(lag[0]) < view.least_lag(2.0 * LATE) or not share[0] < MENDED:
        return []
    seen = f"{_moved(lag[0])} relative to the reference and the IMU"
    return [Finding(("q", "contact"), seen, "another clock, or lost rows")]


def _late_parts(view: LogView, legs: Stance) -> list[Finding]:
    """Find a delay of contacts relative to joints, of all or of one, and of single legs relative to
    the others.
    """

    def with_later_contacts(seconds: float) -> Stance:
        rows = np.searchsorted(view.t, view.at[legs.which] + seconds)
        return replace(legs, contact=view.log.contact[np.clip(rows, 0, len(view.t) - 1)])

    contact, left = _lags(with_later_contacts, LATEST_STREAM)
    motion, beside = _lags(partial(_with_earlier_motion, view, legs), LATEST_STREAM)
    mends = (np.abs(contact) > view.least_lag(LATE_STREAM)) & (left < MENDED)
    moves = (np.abs(motion) > view.least_lag(LATE_STREAM)) & (beside < MENDED)
    if mends[0]:
        cause = "a filter, or another clock of contacts or joints"
        return [
            Finding(view.columns("contact"), f"{_moved(contact[0])}: {_less(1.0 / left[0])}", cause)
        ]
    found = []
    for i, leg in enumerate(view.log.legs, 1):
        if mends[i] and left[i] < beside[i]:
            seen, cause = (
                f"{_moved(contact[i])}: {_less(1.0 / left[i])}",
                "unlike the other contacts",
            )
            found.append(Finding((f"contact_{leg}",), seen, cause))
        elif moves[i]:
            seen, columns = f"{leg} {_moved(motion[i])}", (f"q_{leg}", f"contact_{leg}")
            found.append(Finding(columns, seen, "a clock of its own"))
    return found if 2 * len(found) <= len(view.log.legs) else []


def _with_earlier_motion(view: LogView, legs: Stance, seconds: float) -> Stance:
    """The feet with the body's motion of some seconds earlier, as if they were that late."""
    then = np.clip(legs.which - round(seconds / STEP), 0, len(view.at) - 1)
    used = legs.used & view.ok[then]
    return replace(legs, gyro=view.gyro[then], v_I=view.v_I[then], used=used)


def _lags(lagging: Callable[[float], Stance], latest: float) -> tuple[np.ndarray, np.ndarray]:
    """The delays (1 + L,) [s], up to `latest`, with the smallest misfits, and their ratios to those
    at 0; 0 and 1 where there is no minimum.

    `lagging` gives the feet for a delay.
    """
    tried = STEP * np.arange(-round(latest / STEP), round(latest / STEP) + 1)
    every = np.array([misfits(lagging(float(lag))) for lag in tried])
    base = every[len(tried) // 2]
    every = np.where(np.isfinite(every), every, np.inf)
    best = every.argmin(axis=0)
    found = (best > 0) & (best < len(tried) - 1) & (base > 0.0)
    share = every.min(axis=0) / np.where(found, base, 1.0)
    return np.where(found, tried[best], 0.0), np.where(found, share, 1.0)


def _moved(lag: float) -> str:
    return f"{abs(lag):.2f} s {'late' if lag > 0 else 'early'}"


def _less(gain: float, how: str = "if corrected") -> str:
    return f"the mean square velocity of standing feet is {gain:.3g} times less {how}"


def _put_right(view: LogView, legs: Stance, misfit: bool) -> list[Finding]:
    """Find the correction with the smallest misfit: other legs where there is a `misfit` of all
    together, or other signs and orders of joints.
    """
    gain, found = _swapped(view, legs) if misfit else (1.0, [])
    more, misread = _misread(view, legs)
    return misread if more > gain else found


def _swapped(view: LogView, legs: Stance) -> tuple[float, list[Finding]]:
    """Find swapped legs, by joints, contacts or both, or inverted contacts.

    Also returns the reduction of the squared misfit when corrected.
    """
    names, chains, base = view.log.legs, view.chains, misfits(legs)[0]
    every = range(len(names))
    left, order, swapped = base, list(every), ()
    # First those that exchange fewer legs.
    orders = sorted(permutations(every), key=lambda one: sum(i != j for i, j in enumerate(one)))
    for one in map(list, orders[1:]):
        contact = legs.contact[:, one]
        ways = {("contact_",): replace(legs, contact=contact)}
        if chains is not None:
            joints = _read_otherwise(view, legs, chains[one])
            ways |= {("q_",): joints, ("q_", "contact_"): replace(joints, contact=contact)}
        for kinds, moved in ways.items():
            if (misfit := misfits(moved)[0]) < CLEARER * left:
                left, order, swapped = misfit, one, kinds
    # In a trot, the other diagonal stands while this one is lifted, so both may fit.
    inverted = misfits(replace(legs, contact=~legs.contact))[0]
    likelier = 3.0 if legs.contact.mean() < DUTY else 1.0 / 3.0
    if legs.has_truth and inverted < min(MENDED * base, likelier * left):
        columns, gain = view.columns("contact"), base / inverted
        return gain, [Finding(columns, _less(gain), "inverted: 1 means lifted")]
    if left > MENDED * base:
        return 1.0, []
    wrong = [(names[i], names[j]) for i, j in enumerate(order) if i != j]
    columns = tuple(f"{kind}{i}" for kind in swapped for i, _ in wrong)
    what = " and ".join({"q_": "joints", "contact_": "contacts"}[kind] for kind in swapped)
    cause = f"swapped legs ({what}): {', '.join(f'{i} is {j}' for i, j in wrong)}"
    changes = {}
    if swapped == ("contact_",):
        # Or of the forces by which these were detected.
        kind = "force" if "contact from force" in view.log.meta.derived else "contact"
        changes = {"columns": {f"{kind}_{i}": {"of": f"{kind}_{j}"} for i, j in wrong}}
    return base / left, [Finding(columns, _less(base / left), cause, changes)]


def _read_otherwise(
    view: LogView,
    legs: Stance,
    others: np.ndarray,
    sign: np.ndarray | float = 1.0,
    offset: np.ndarray | float = 0.0,
) -> Stance:
    """The feet for another reading of the joints.

    Args:
        view: of the log.
        legs: their times.
        others: joints whose angles are taken for those of each leg (L, C).
        sign: of these (C,).
        offset: (C,) [rad] added to them.
    """
    robot, q = view.robot, view.log.q
    assert robot is not None
    return legs.with_feet(lambda rows: robot.feet_I(exchanged(view, q[rows], others, sign, offset)))


def _misread(view: LogView, legs: Stance) -> tuple[float, list[Finding]]:
    """Find joints that are swapped within a leg, or have the opposite sign.

    Also returns the reduction of the squared misfit when corrected.
    """
    robot, chains = view.robot, view.chains
    if robot is None or chains is None or not legs.has_truth or chains.shape[1] > 3:
        return 1.0, []
    in_order, base = np.arange(chains.shape[1]), misfits(legs)[1:]
    # Legs that fit have their joints in order, but a hip about 0 rad may have another sign.
    orders = permutations(in_order) if (base > MISFIT).any() else [in_order]
    signs = product((1.0, -1.0), repeat=len(in_order))
    ways = [(np.array(order), np.array(sign)) for order, sign in product(orders, signs)]
    left, leans = np.empty((2, len(ways), len(chains)))
    for way, (order, sign) in enumerate(ways):
        left[way] = misfits(_read_otherwise(view, legs, chains[:, order], sign))[1:]
        leans[way] = leaning(view, legs, chains[:, order], sign)
    best, left = left.argmin(axis=0), left.min(axis=0)
    upright = (leans[0] > LEANS) & (leans[best, np.arange(len(best))] < 0.5 * leans[0])
    mends = (best > 0) & (left < np.where(upright, CLEARER, MENDED_JOINTS) * base)
    findings = []
    for leg in np.flatnonzero(mends):
        order, sign = ways[best[leg]]
        swapped, flipped = order != in_order, sign < 0
        columns = view.columns("q", chains[leg][swapped | flipped])
        kinds = [robot.limbs.kind_of[j] for j in chains[leg]]
        words = ", ".join(f"{kinds[i]} is {kinds[order[i]]}" for i in np.flatnonzero(swapped))
        causes = [f"swapped joints ({words})"] * bool(words) + ["wrong sign"] * bool(flipped.any())
        negative = {view.log.joints[j]: -1.0 for j in chains[leg][flipped]}
        changes = {"robot": {"joint_sign": negative}} if negative else {}
        seen = _less(base[leg] / left[leg])
        findings.append(Finding(columns, seen, " and ".join(causes), changes))
    mended = np.nansum(np.where(mends, left, base))
    return float(np.nansum(base) / max(mended, 1e-12)), findings


def opposite_angles(view: LogView) -> set[str]:
    """Columns of angles that put standing feet right with the opposite sign."""
    found = [] if view.stance is None else _misread(view, _few(view.stance))[1]
    return {column for one in found if one.cause == "wrong sign" for column in one.streams}


def _few(legs: Stance) -> Stance:
    """Feet at some of the times at which the body turns most, where legs differ; at these,
    alternatives are tried.
    """
    rate = np.linalg.norm(legs.gyro, axis=1)
    used = np.flatnonzero(legs.used & (rate > np.quantile(rate, _TURNING)))
    return legs.at(used[np.linspace(0, len(used) - 1, min(len(used), _TRIED)).astype(int)])


def _of_another_robot(legs: Stance) -> list[Finding]:
    """Find legs of another length, or that have nothing to do with the body's motion."""
    moves = legs.used & (np.linalg.norm(legs.v_I, axis=1) > _MOVES)
    on, misfit = legs.contact & moves[:, None], misfits(legs)[0]
    by_body = np.broadcast_to(legs.v_I[:, None], legs.foot.shape)[on][:, :2]
    by_legs = legs.by_leg[on][:, :2]
    size = np.sum(by_legs**2, axis=1)
    keep = size < np.quantile(size, 0.9)
    by_legs, by_body = by_legs[keep], by_body[keep]
    both, power = np.sum(by_legs * by_body), np.sum(by_body**2)
    ratio, alike = both / power, both / np.sqrt(power * np.sum(by_legs**2))
    if alike > 0.6 and not SIZE[0] < ratio < SIZE[1]:
        seen = f"legs move the body {ratio:.2f} times as fast as the reference"
        cause = "another robot's log (its legs have another length), or units of positions"
        return [Finding(("q", "ref_p"), seen, cause)]
    if misfit > HOPELESS:
        seen = f"standing feet have {100 * misfit:.0f} % of the body's mean square velocity"
        return [Finding(("q", "contact"), seen, "wrong joints, contacts or robot; or it slides")]
    return []


def _climbing(view: LogView, legs: Stance) -> list[Finding]:
    """Find a reference that climbs or sinks, and its feet do not."""
    up = view.R_GI.inv().apply([0.0, 0.0, 1.0])[legs.which]
    apart = legs.v_I[:, None] - legs.by_leg
    on = legs.contact & legs.used[:, None]
    climb = float(np.median(np.einsum("kli,ki->kl", apart, up)[on])) if on.sum() >= FEWEST else 0.0
    if abs(climb) <= CLIMBS:
        return []
    seen = f"{'climbs' if climb > 0 else 'sinks'} by {abs(climb):.2f} m/s, and the feet do not"
    return [Finding(("ref_p_z",), seen, "an estimate that drifts, or a world that is not level")]


def _zeros(view: LogView, legs: Stance) -> list[Finding]:
    """Find joints of most legs whose angles count from elsewhere than the model's.

    `joints.zeros` finds that of a single joint.
    """
    chains = view.chains
    if chains is None:
        return []
    base = misfits(legs)[1:]
    every = np.empty((chains.shape[1], len(OFFSETS), len(chains)))
    for k, n in np.ndindex(every.shape[:2]):
        offset = OFFSETS[n] * np.eye(chains.shape[1])[k]
        every[k, n] = misfits(_read_otherwise(view, legs, chains, offset=offset))[1:]
    if not np.isfinite(every).all():
        return []
    left = every.min(axis=1) / base  # by joint of a leg, and leg
    columns, seen = [], []
    for k in np.argsort(np.median(left, axis=1)):
        which = np.flatnonzero((left[k] < MENDED) & (base > MISFIT))
        if 2 * len(which) > len(chains):
            columns += view.columns("q", chains[which, k])
            added = sorted({float(OFFSETS[every[k, :, i].argmin()]) for i in which})
            words = " or ".join(f"{x:+g}" for x in added)
            seen.append(_less(1.0 / float(np.median(left[k, which])), f"with {words} rad added"))
    if not columns:
        return []
    cause = "other zeros than the model's: measure them for joint_offset in [robot] of the map"
    return [Finding(tuple(columns), ", ".join(seen), cause)]
