"""The study's jobs in other processes of this machine, or on a Dask cluster: the same numbers."""

from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context

from surefoot.scenarios.datasets.cluster import run_on_cluster
from surefoot.scenarios.studies.montecarlo.batch import Scores
from surefoot.scenarios.studies.montecarlo.study import Job, run_job
from surefoot.sim.common.errors import SurefootError


def on_workers(jobs: Sequence[Job], workers: int) -> Iterator[tuple[int, list[Scores]]]:
    """All jobs on that many processes of this machine, one thread each."""
    if workers < 1:
        raise SurefootError(f"--workers {workers}: at least 1")
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        places = {pool.submit(_alone, job): place for place, job in enumerate(jobs)}
        for future in as_completed(places):
            yield places[future], future.result()


def on_cluster(address: str, jobs: Sequence[Job]) -> Iterator[tuple[int, list[Scores]]]:
    """All jobs on the workers of the scheduler at `address`, which need surefoot installed."""
    return run_on_cluster(address, _alone, jobs)


def _alone(job: Job) -> list[Scores]:
    return run_job(job, threads=1)
