"""Summary of an estimate: metrics, coverage of its bounds, and errors over time."""

from dataclasses import asdict
from typing import Any

import numpy as np
import pandas as pd

from surefoot.estimator.evaluation.trajectory import Trajectory, reference
from surefoot.models.observer.samples import body_velocity
from surefoot.scenarios.estimate.contract import Learnt
from surefoot.scenarios.estimate.error_series import error_series
from surefoot.scenarios.estimate.estimators import estimator_named
from surefoot.scenarios.estimate.run import Result
from surefoot.sim.log import Log

ERRORS_RATE = 5.0
"""Rate of the errors that are stored for figures [Hz]."""


def estimate_facts(log: Log, result: Result, learnt: Learnt) -> dict[str, Any]:
    """Metrics of an estimate, time per step, trustworthiness, and statistics of the velocities
    used.

    The latter are the mean error (3,) and the share within the bounds. Bounds on other quantities
    than a velocity, such as the mean of a window with a persistent part, are not evaluated here.
    """
    facts: dict[str, Any] = {"step_us": 1e6 * result.step_time}
    if result.metrics is not None:
        facts |= asdict(result.metrics)
    if result.health.lost:
        facts |= {"lost_from": result.health.since, "lost": result.health.sentence(result.filter)}
    updates = result.trajectory.updates
    if updates is None or not log.has("reference"):
        return facts
    v_I, measured = body_velocity(log, np.searchsorted(log.t, updates.t - 1e-6))
    errors = (updates.v_I - v_I)[measured]
    facts["fed_mean"] = errors.mean(axis=0).tolist()
    if updates.epsilon is not None and hasattr(estimator_named(result.filter), "bounded_by"):
        share = float(np.all(np.abs(errors) <= updates.epsilon[measured], axis=1).mean())
        # Successive errors are not independent; those K steps apart are.
        n = max(len(errors) // max(bounds.K for bounds in learnt.bounds), 1)
        facts |= {"coverage": share, "coverage_n": n}
    return facts


def errors_over_time(log: Log, estimate: Trajectory) -> pd.DataFrame:
    """Aligned path, truth and the filter's sigma over time, at ERRORS_RATE."""
    errors = error_series(reference(log), estimate, ERRORS_RATE)
    columns = {"t": errors.t, "distance": errors.distance}
    for k, axis in enumerate("xyz"):
        columns |= {f"p_{axis}": errors.p_GI[:, k]}
        columns |= {f"ref_{axis}": errors.p_GI[:, k] - errors.position[:, k]}
    if errors.distance_sigma is not None:
        columns["sigma"] = errors.distance_sigma
    return pd.DataFrame({name: values.astype(np.float32) for name, values in columns.items()})
