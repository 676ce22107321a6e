"""Walks on a Dask cluster of real processes on this machine, one of them killed half-way."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pytest
from courses import course_file
from dataset_index import digests, read_index
from refusals import refused

from surefoot.scenarios.datasets.simulate import simulate
from surefoot.scenarios.settings import SimulateSettings

distributed = pytest.importorskip("distributed")

ROOT = Path(__file__).parents[2]
QUIET = {"DASK_DISTRIBUTED__LOGGING__DISTRIBUTED": "error", "PYTHONPATH": str(ROOT)}


class Cluster:
    """A scheduler and workers, each a process of its own on 127.0.0.1."""

    def __init__(self, folder: Path, workers: int):
        self.folder, self.processes = folder, []
        folder.mkdir(exist_ok=True)
        file = folder / "scheduler.json"
        self.run("dask_scheduler", f"--no-dashboard --port 0 --scheduler-file {file}")
        while not file.exists():
            time.sleep(0.05)
        self.workers = [
            self.run(
                "dask_worker",
                f"--scheduler-file {file} --no-nanny --nthreads 1 --no-dashboard "
                f"--local-directory {folder / str(i)}",
            )
            for i in range(workers)
        ]
        self.address = json.loads(file.read_text())["address"]
        with distributed.Client(self.address, set_as_default=False) as client:
            client.wait_for_workers(workers, timeout=60)

    def run(self, module: str, options: str) -> subprocess.Popen:
        command = [sys.executable, "-m", f"distributed.cli.{module}", "--host", "127.0.0.1"]
        process = subprocess.Popen(
            [*command, *options.split()], env=os.environ | QUIET, cwd=self.folder
        )
        self.processes.append(process)
        return process

    def stop(self) -> None:
        for process in reversed(self.processes):
            process.kill()
            process.wait()


@pytest.fixture
def cluster(tmp_path, monkeypatch, cliff) -> Iterator[Cluster]:
    monkeypatch.chdir(tmp_path)
    course_file(tmp_path, 3.0)
    cluster = Cluster(tmp_path, workers=2)
    yield cluster
    cluster.stop()


@pytest.mark.long
def test_a_worker_dies_half_way_and_no_bit_differs(cluster):
    """Two processes walk, one is killed by SIGKILL as soon as the first log is here."""

    def kill_one() -> None:
        while not list(Path("far").glob("*.parquet")):
            time.sleep(0.005)
        cluster.workers[0].send_signal(signal.SIGKILL)

    killer = threading.Thread(target=kill_one, daemon=True)
    killer.start()
    courses = [Path("short.toml"), Path("cliff.toml")]
    rows = simulate(SimulateSettings(courses, Path("far"), seeds="0:5", cluster=cluster.address))
    killer.join(timeout=1.0)
    assert cluster.workers[0].poll() == -signal.SIGKILL
    assert cluster.workers[1].poll() is None
    assert len(rows) == 10
    simulate(SimulateSettings(courses, Path("near"), seeds="0:5", workers=2))
    assert digests("far") == digests("near")
    assert len(digests("far")) == 5
    pd.testing.assert_frame_equal(read_index(Path("far")), read_index(Path("near")))


@pytest.mark.long
def test_a_scheduler_that_dies_is_one_line_and_on_another_the_walks_go_on(cluster, tmp_path):
    def kill() -> None:
        while not list(Path("far").glob("*.parquet")):
            time.sleep(0.005)
        cluster.stop()

    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    short, far = [Path("short.toml")], Path("far")
    there = SimulateSettings(short, far, seeds="0:6", cluster=cluster.address)
    refused(r"cluster tcp://127\.0\.0\.1", simulate, there)
    killer.join(timeout=1.0)
    assert 1 <= len(first := digests("far")) < 6
    again = Cluster(tmp_path / "again", workers=1)
    try:
        simulate(SimulateSettings(short, far, seeds="0:6", cluster=again.address))
    finally:
        again.stop()
    assert first.items() <= digests("far").items()
    simulate(SimulateSettings(short, Path("near"), seeds="0:6"))
    assert digests("far") == digests("near")
