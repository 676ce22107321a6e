"""Regressors of a trace against the slope of the residual itself."""

import numpy as np

from surefoot.models.attribution.evidence import _Linear, table_of
from surefoot.sim.effects import CATALOGUE, effect


def step_of(key):
    """A hundredth of the step by which an effect is differenced."""
    return 1e-2 * CATALOGUE[key[0]].traced_at(key[1]).step


def slope_of(case, key, step):
    """What a unit of the effect adds to the table (M, W), by the residual itself."""
    (name, target), table = key, table_of(case, ())
    return np.nan_to_num((table - table_of(case, [effect(name, target, step)])) / step)


def written_out(one, like):
    """A regressor on all columns."""
    whole = np.zeros_like(like)
    whole[:, one.columns] = one.values
    return whole


def regressor_of(case, key, like):
    return written_out(_Linear(case, ()).regressor(key), like)


def apart(whole, slope, columns):
    """Norm of the difference of two tables in some columns, as a share of that of the second."""
    return np.linalg.norm((whole - slope)[:, columns]) / np.linalg.norm(slope[:, columns])
