"""Evidence with a known answer: smooth random regressors of known sizes, in noise."""

import numpy as np

from surefoot.models.attribution.evidence import Evidence
from surefoot.models.residuals.jacobians import sparse
from surefoot.models.residuals.layout import layout_for
from surefoot.sim.robot import limbs

QUADRUPED = layout_for(limbs.QUADRUPED)
KEYS = (
    ("encoder_offset", "FL_hip"),
    ("encoder_offset", "FL_thigh"),
    ("gyro_scale", "x"),
    ("joint_delay", "all"),
)


BINS = 1500


WIDTH = QUADRUPED.width


NOISE = np.repeat([5e-4, 1e-2, 2e-3, 1.0], [3, 3, 12, WIDTH - 18])


def evidence(sizes=(0, 0, 0, 0), bias=(0, 0, 0, 0, 0, 0), seed=0, noise=NOISE):
    """Smooth random regressors on the columns that effects touch; feet stand half the time."""
    rng = np.random.default_rng(seed)
    t = 0.01 + 0.02 * np.arange(BINS)
    X = np.zeros((BINS, WIDTH, len(KEYS)))
    waves = np.sin(
        2 * np.pi * rng.uniform(0.3, 4, (18, 4)) * t[:, None, None] + rng.uniform(0, 6, (18, 4))
    )
    X[:, 6:9, 0], X[:, 6:9, 1] = waves[:, 6:9, 0], waves[:, 6:9, 1]
    X[:, 0, 2] = 0.4 * waves[:, 0, 2]
    X[:, 6:18, 3] = 3.0 * waves[:, 6:18, 3]
    Z = np.zeros((BINS, WIDTH, 6))
    Z[:, range(6), range(6)] = 1.0
    Z[:, 6:18, :3] = 0.3
    table = X @ np.asarray(sizes, float) + Z @ np.asarray(bias, float)
    table += rng.normal(size=table.shape) * noise
    standing = (np.arange(BINS)[:, None] // 12 + np.array([0, 1, 1, 0])) % 2 == 0
    table[:, 6:18][np.repeat(~standing, 3, axis=1)] = np.nan
    table[:, 18:] = np.nan
    return made_of(t, table, X, Z)


def made_of(t, table, X, Z):
    return Evidence(
        layout=QUADRUPED,
        t=t,
        log=np.zeros(len(t), int),
        table=table,
        keys=KEYS,
        X=tuple(sparse(X[..., i], table) for i in range(X.shape[2])),
        Z=tuple(sparse(Z[..., i], table) for i in range(Z.shape[2])),
        deviations=np.full(6, 0.2),
        bias_of=(None,) * 6,
    )
