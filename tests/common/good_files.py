"""One folder of good files of every kind, which each hostile case gets a copy of."""

import os
from dataclasses import replace
from pathlib import Path

import good_texts
import numpy as np
import torch
from synthetic import synthetic_walk

from surefoot.models.calibration.bounds import Bounds
from surefoot.models.observer.observer import observer_of_torch
from surefoot.sim.log import LEGS

FILES = Path(__file__).resolve().parents[1] / "data" / "0.1.0"


def good_files(folder: Path) -> Path:
    """Good files in a new folder; `mine.txt` and `user/` are the user's own."""
    folder.mkdir()
    log = synthetic_walk(0, 3.0, noise=0.1, robot="spot_class")
    stands = {f"contact_{leg}": np.ones(len(log.t)) for leg in LEGS}
    replace(log, frame=log.frame.assign(**stands)).write(folder / "walk.parquet")
    observer_of_torch(FILES / "observer_q_dq_gml.pt").save(folder / "observer.safetensors")
    Bounds.load(FILES / "bounds.json").save(folder / "bounds.json")
    named = {
        "scenario.toml": good_texts.SCENARIO,
        "effects.toml": good_texts.EFFECTS,
        "map.toml": good_texts.MAP,
        "data.csv": good_texts.CSV,
        "experiment.toml": good_texts.EXPERIMENT,
        "settings.toml": good_texts.SETTINGS,
        "robot.xml": good_texts.ROBOT,
        "robot.urdf": good_texts.URDF,
        "old_bounds.json": (FILES / "bounds.json").read_text(),
        "mine.txt": "mine",
        "mine.tum": "mine",
        "fake.rrd": "mine",
    }
    named |= {f"user/{n}": "mine" for n in USERS}
    for name, text in named.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text)
    (folder / "sub").mkdir()
    (folder / "link").symlink_to("walk.parquet")
    (folder / "here").symlink_to(".")
    (folder / "dangling").symlink_to("nothing")
    os.link(folder / "walk.parquet", folder / "hard")
    os.mkfifo(folder / "pipe")
    _warm(folder)
    return folder


USERS = (
    *("report.html", "alignment.json", "results.csv", "short_0.parquet", "tuned.toml"),
    *("walking.md", "trace.json"),
)


def _warm(folder: Path) -> None:
    """Import what commands import, so that a child of this process does not."""
    import surefoot.models.attribution.diagnose
    import surefoot.scenarios.cli.main
    import surefoot.scenarios.experiments.report
    import surefoot.scenarios.trace.loop
    import surefoot.scenarios.tune  # noqa: F401
    from surefoot.scenarios.estimate.run import run_filter
    from surefoot.sim.log import Log
    from surefoot.sim.robot import Robot

    torch.set_num_threads(1)
    # Kernels are compiled here, for a child's work would be lost with it.
    run_filter("leg", Log.read(folder / "walk.parquet"), Robot.load("spot_class"))
