"""Errors of a filter on a log that has a reference."""

from surefoot.estimator.metrics import Metrics
from surefoot.scenarios.estimate.run import run_filter
from surefoot.sim.log import Log


def metrics_of(name: str, log: Log, *arguments, **options) -> Metrics:
    """Metrics of an estimator by name; what follows the log is that of `run_filter`."""
    metrics = run_filter(name, log, *arguments, **options).metrics
    assert metrics is not None
    return metrics
