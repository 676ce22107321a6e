"""What a fresh clone compiles, and that kernels compiled ahead are those that filters use."""

from contextlib import nullcontext
from pathlib import Path

import pytest
from processes import printed

from surefoot.scenarios import first_use

COMPILED = """
import collections
from numba.core import event

class Count(event.Listener):
    def on_start(self, event):
        function = event.data["dispatcher"].py_func
        count[function.__module__ + "." + function.__qualname__] += 1

    def on_end(self, event):
        pass

count = collections.Counter()
event.register("numba:compile", Count())
{work}
for name, times in count.items():
    print(times, name)
"""
FILTERS = """
from surefoot.scenarios.first_use import COMPILATIONS
for compiled in COMPILATIONS:
    compiled()
"""
ESTIMATES = """
import numpy as np
from surefoot.estimator.core.state import NavState
from surefoot.estimator.filter import InvariantFilter
from surefoot.estimator.run import gaussian_velocities, imu_samples
from surefoot.models.observer.gru import scan
t, still, start = np.arange(50) * 0.01, np.zeros((50, 3)), (NavState(), np.eye(15))
imu = imu_samples(t, still, still)
InvariantFilter(*start).run(imu)
InvariantFilter(*start).run(imu, gaussian_velocities(np.arange(1, 9), still[1:9], np.eye(3), 50))
scan(*(np.zeros(n, np.float32) for n in ((2, 3, 24), (8, 24), 24, (3, 8))))
"""
SEVERAL = ("add_cross_columns", "is_outlier", "_rotate", "add_velocity")
"""Small kernels that are compiled for numbers, or for rows and columns, at a tenth of a second."""


def compiled(work: str, cache: Path) -> dict[str, int]:
    """Names of the functions that are compiled, and how often."""
    said = printed("-c", COMPILED.format(work=work), env={"SUREFOOT_CACHE": str(cache)})
    pairs = (line.split(maxsplit=1) for line in said.splitlines())
    return {name: int(times) for times, name in pairs}


@pytest.mark.slow
def test_a_fresh_clone_compiles_each_kernel_once_and_no_formatting_of_messages(tmp_path):
    first = compiled(FILTERS, tmp_path)
    ours = {name: times for name, times in first.items() if name.startswith("surefoot.estimator")}
    assert "surefoot.estimator.filter._run" in ours
    twice = [name for name, times in ours.items() if times > 1 and not name.endswith(SEVERAL)]
    assert not twice
    assert not [name for name in first if ".unicode." in name]
    assert not compiled(ESTIMATES, tmp_path)


@pytest.mark.parametrize("lacking", [True, False])
def test_filters_are_compiled_meanwhile_only_where_the_cache_lacks_them(monkeypatch, lacking):
    tasks = []
    monkeypatch.setattr(first_use, "lacks_code", lambda module: lacking)
    monkeypatch.setattr(first_use, "processes", lambda workers: nullcontext("pool"))
    monkeypatch.setattr(first_use, "submitted", lambda pool, task: tasks.append(task))
    with pytest.raises(ValueError, match="meanwhile"), first_use.filters_compiled_meanwhile():
        raise ValueError("meanwhile")
    assert tasks == ([(one,) for one in first_use.COMPILATIONS] if lacking else [])
