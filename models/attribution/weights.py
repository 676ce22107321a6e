"""Weights of the entries of a residual table.

Outliers count less. Stances in which a foot slid or stood on an edge, and bins in which a joint
with dry friction nearly stands still, do not count. Weights and masks of stances are computed after
fitting the whole catalogue, so that neither can remove an effect of the catalogue: a stance is
masked if it stands out from the other stances of its foot, not if all of them are wrong.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from surefoot.models.attribution.design import (
    FREE,
    design,
    nuisance_precision,
    scaled_inverse,
)
from surefoot.models.attribution.effect_sizes import plausible_size
from surefoot.models.attribution.evidence import Evidence, LogUnderModel
from surefoot.models.residuals.binning import BIN, bin_mean
from surefoot.models.residuals.layout import Layout
from surefoot.models.residuals.torques import dilate
from surefoot.sim.effects import Effect, effect, known_effects
from surefoot.sim.effects.drive import DriveEffect
from surefoot.sim.log import joint_velocity
from surefoot.sim.physics.loads import STICTION_RATE

OUTLIER = 2.5
"""Standard deviations beyond which an entry of the table loses weight."""
ROUNDS = 3
"""Iterations of weights and noise, after which they hardly change."""
SLIP_OUTLIER = 6.0
"""Robust deviations above its foot's median from which a stance is masked."""
SLOWEST_SLIP = 0.02
"""Speed below which a standing foot creeps on compliant contacts and does not slide [m/s]."""
RAISED_STANCE = 0.001
"""Deviation of a stance's height from the foot's others from which it is on an edge [m]."""
FEWEST_STANCES = 5
"""Stances of a foot from which one of them can stand out."""
FAR_ABOVE = 3.0
"""Ratio to the floor from which what is left of a channel is an error of the model, which recurs in
every stance and makes all sizes uncertain.
"""
MOST_LAGS = 15
"""Lags over which autocorrelations are summed, in entries: the length of a stance."""
SLOW = 0.5
"""Share of a joint's RMS rate below which it is slow, at most: small slides never reach
STICTION_RATE.
"""


@dataclass(frozen=True)
class RobustWeights:
    """Noise and weights of a residual table.

    Attributes:
        sigma: noise of each column (W,), in the residual's unit.
        weight: (M, W) in 0..1, zero where missing or masked.
        masked: masked foot bins (M, legs).
        share: share of the bins in stance that is masked.
        alike: successive entries of each column that count as one of white noise (W,).
    """

    sigma: np.ndarray
    weight: np.ndarray
    masked: np.ndarray
    share: float
    alike: np.ndarray


def robust_weights(evidence: Evidence, floor: np.ndarray) -> RobustWeights:
    """Compute robust weights of an evidence with noise floor `floor` (W,)."""
    # Groups of candidates are sums of others.
    data = design(evidence.only([key for key in evidence.keys if key not in evidence.groups]))
    prior, layout, there = _prior_precision(data.evidence), evidence.layout, data.there

    def left_of(sigma: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """What all candidates and nuisance parameters together do not explain (M, W)."""
        root, every = np.sqrt(weight) / sigma, np.zeros(len(weight), int)
        G = data.grams(data.y, root, layout.fitted, every)[0]
        sizes = scaled_inverse(G[1:, 1:] + prior) @ G[1:, 0]
        return np.where(there, data.y - data.explained(sizes), np.nan)

    feet = layout.by_leg("leg_velocity")
    legged = len(feet) > 0
    masked = np.zeros((len(there), len(feet)), dtype=bool)
    spoiled = np.zeros(there.shape, dtype=bool)
    left = np.where(there, data.y, np.nan)
    if legged:
        sigma, weight = np.where(floor > 0, floor, 1e-12), there.astype(float)
    else:
        # From what stands out of the whole residual: beside it, sizes could explain a strong push.
        # A walk has slips and its base's wrench to tell them by.
        sigma, weight = _noise_and_weights(layout, left, floor, there)
    for last in (False, True) if legged else (True,):
        for _ in range(ROUNDS):
            left = left_of(sigma, weight)
            sigma, weight = _noise_and_weights(layout, left, floor, there & ~spoiled)
        if not last:
            sliding, elsewhere = slips(evidence, left)
            masked, spoiled = sliding | elsewhere, _invalidated(layout, sliding, elsewhere)
    standing = there[:, feet[:, 0]].sum() if legged else 0
    share = float(masked.sum() / max(standing, 1))
    z = np.clip(left / sigma, -OUTLIER, OUTLIER)
    alike = correlated_entries(layout, np.where(weight > 0, z, np.nan))
    # A model error within the stance recurs in every stance, so more stances do not make it more
    # certain: a column far above the floor counts as one entry, and the mean over the stance, which
    # is a channel of its own, decides.
    columns = layout.of("leg_velocity")
    columns = columns[sigma[columns] > FAR_ABOVE * floor[columns]]
    alike[columns] = np.count_nonzero(weight[:, columns], axis=0).clip(1)
    return RobustWeights(sigma, weight, masked, share, alike)


def _prior_precision(known: Evidence) -> np.ndarray:
    """Prior precision (C + B, C + B) of candidates and nuisance parameters.

    Without a prior, sizes that no machine has explain anything: a torque scale of -1 and a robot
    without masses.
    """
    kinds, limbs = known_effects(), known.layout.limbs
    of_sizes = [
        (plausible_size(*key, limbs) / 1.96) ** -2.0 if key[0] in kinds else FREE
        for key in known.keys
    ]
    return np.diag(np.append(of_sizes, nuisance_precision(known)))


def correlated_entries(layout: Layout, z: np.ndarray) -> np.ndarray:
    """Integrated autocorrelation (W,): successive entries that count as one of white noise.

    One plus twice the sum of the autocorrelations of z (M, W) up to their first zero, pooled over
    similar columns. Missing entries are skipped, so that successive stances adjoin.
    """
    worth = np.ones(layout.width)
    for columns in layout.alike:
        products = np.zeros(MOST_LAGS + 1)
        for c in columns:
            own = z[np.isfinite(z[:, c]), c]
            if len(own) > MOST_LAGS:
                own = own - np.mean(own)
                products += [own[k:] @ own[: len(own) - k] for k in range(MOST_LAGS + 1)]
        shares = products / max(products[0], 1e-300)
        vanished = int(np.argmax(np.append(shares, -1.0) < 0.0))
        worth[columns] = max(1.0, 1.0 + 2.0 * float(shares[1:vanished].sum()))
    return worth


def _invalidated(layout: Layout, sliding: np.ndarray, elsewhere: np.ndarray) -> np.ndarray:
    """Mask (M, W) of the entries affected by feet (M, legs) that slid or stood elsewhere.

    A foot affects its own columns and those that belong to no foot, of the channels that declare
    the cause.
    """
    spoiled = np.zeros((len(sliding), layout.width), dtype=bool)
    flags = {"slid": sliding, "elsewhere": elsewhere}
    for c, (column, causes) in enumerate(zip(layout.columns, layout.masked_by, strict=True)):
        for cause in causes:
            flag = flags[cause]
            spoiled[:, c] |= flag.any(axis=1) if column.leg is None else flag[:, column.leg]
    return spoiled


def slips(known: Evidence, left: np.ndarray) -> np.ndarray:
    """Foot bins (2, M, legs) of the stances that stand out from their foot's others, by speed and
    by height.

    `left` (M, W) is the residual that the catalogue does not explain. A stance is judged by its
    fastest bin, since a sliding foot sticks again before the stance is over and a mean would miss
    every second slip; and by its height, since a foot on an edge does not slide.
    """
    layout = known.layout
    velocity, heights = layout.by_leg("leg_velocity"), layout.by_leg("foot_height")
    masked = np.zeros((2, len(left), len(velocity)), dtype=bool)
    for leg in range(len(velocity)):
        speed = np.sqrt(np.sum(left[:, velocity[leg]] ** 2, axis=1))
        stances = _stances(known, np.isfinite(speed))
        if len(stances) < FEWEST_STANCES:
            continue
        fastest = np.array([speed[bins].max() for bins in stances])
        height = np.nan_to_num(np.array([left[bins, heights[leg, 0]].mean() for bins in stances]))
        off = np.abs(height - np.median(height))
        for kind, score, least in ((0, fastest, SLOWEST_SLIP), (1, off, RAISED_STANCE)):
            middle = np.median(score)
            # Spread from the lower quartile, since slips inflate the upper side only.
            spread = 1.4826 * (middle - np.quantile(score, 0.25))
            most = max(middle + SLIP_OUTLIER * spread, least)
            for stance in np.flatnonzero(score > most):
                masked[kind, stances[stance], leg] = True
    return masked


def _stances(known: Evidence, there: np.ndarray) -> list[np.ndarray]:
    """Indices of the bins of each stance: adjacent in time, in one log, with a value of the
    foot (M,).
    """
    rows = np.flatnonzero(there)
    apart = (np.diff(known.t[rows]) > 1.5 * BIN) | (np.diff(known.log[rows]) != 0)
    return np.split(rows, np.flatnonzero(apart) + 1)


def _noise_and_weights(
    layout: Layout, left: np.ndarray, floor: np.ndarray, used: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Noise of the columns (W,), at least `floor`, and weights (M, W) of the entries of a mask
    `used` (M, W), by what is left of them.
    """
    sigma = np.maximum(floor, _pooled(layout, np.where(used, left, np.nan)))
    return sigma, used * _outlier_weights(layout, left / sigma)


def _pooled(layout: Layout, left: np.ndarray) -> np.ndarray:
    """Robust standard deviation of each column, pooled over similar ones."""
    sigma = np.zeros(layout.width)
    for columns in layout.alike:
        values = np.abs(left[:, columns])
        values = values[np.isfinite(values)]
        sigma[columns] = 1.4826 * np.median(values) if len(values) else 0.0
    return np.maximum(sigma, 1e-12)


def _outlier_weights(layout: Layout, z: np.ndarray) -> np.ndarray:
    """Weights (M, W): one up to OUTLIER deviations, then falling as the inverse square."""
    weight = np.ones_like(z)
    for group in layout.groups:
        size = np.sqrt(np.nansum(z[:, group] ** 2, axis=1) / len(group))
        weight[:, group] = np.minimum(1.0, (OUTLIER / np.maximum(size, OUTLIER)) ** 2)[:, None]
    return weight


def sticks(cases: Sequence[LogUnderModel], effects: Sequence[Effect], layout: Layout) -> np.ndarray:
    """Entries (M, W) of the residual table in which a machine on a fixed base may stick.

    A joint that sticks has any friction up to its dry one, and how narrow the transition is differs
    between drives. These torques tell a fit a little, but not whether an effect is missing.

    Args:
        cases: the logs.
        effects: found; the model's file and what is declared of it may have friction as well.
        layout: of the table.
    """
    masks = []
    for case in cases:
        mask = np.zeros((len(case.motion.t), layout.width), dtype=bool)
        if case.fixed and case.log.has("q"):
            rate = joint_velocity(case.log)
            slow = np.minimum(STICTION_RATE, SLOW * np.sqrt(np.mean(rate**2, axis=0)))
            still = bin_mean(case.motion)((np.abs(rate) < slow).astype(float)) > 0.0
            for joint in _with_dry_friction(case, effects):
                at = [n for n, name in enumerate(layout.names) if name == f"torque_{joint}"]
                # The residual is smoothed over three bins.
                mask[:, at] = dilate(still[:, case.log.joints.index(joint)])[:, None]
        masks.append(mask)
    return np.concatenate(masks)


def _with_dry_friction(case: LogUnderModel, effects: Sequence[Effect]) -> set[str]:
    """Names of the joints that have dry friction, by the effects or by the declared model."""
    limbs, dynamics = case.robot.limbs, case.robot.dynamics
    declared = [effect(*key, 0.0) for key, _ in limbs.declared]
    found = {
        joint
        for e in (*declared, *effects)
        if isinstance(e, DriveEffect) and e.dry
        for joint in e.members(limbs)
    }
    if dynamics is None:
        return found
    dry = dynamics.model.dof_frictionloss[dynamics.dof_adr] > 0.0
    return found | {joint for joint, has in zip(limbs.joints, dry, strict=True) if has}
