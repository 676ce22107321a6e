"""Whoever does not train needs no torch: the extra `learn` is for training."""

from pathlib import Path
from shutil import copy

import pytest
from courses import course_file
from processes import python

from surefoot import Log, TrainSettings, train

pytestmark = pytest.mark.long
WITHOUT_TORCH = """
import sys
from importlib.machinery import PathFinder


class WithoutTorch(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        return None if name == "torch" else super().find_spec(name, path, target)


sys.meta_path[sys.meta_path.index(PathFinder)] = WithoutTorch
from surefoot.scenarios.cli.main import main

refused = []
for line in sys.argv[1:]:
    try:
        main(line.split())
    except SystemExit as stop:
        refused.append(str(stop.code))
sys.exit("\\0".join(refused) or None)
"""
LOG, OTHER = "walks/short_0.parquet", "walks/short_1.parquet"
MODELS = {"gru": "mse", "mlp": "gml"}
LEARNT = " ".join(f"--observer {m}.safetensors --bounds {m}.json" for m in MODELS)
OLD = Path(__file__).resolve().parents[1] / "data" / "0.1.0" / "observer_q_dq_gml.pt"


def run(lines, folder):
    return python("-c", WITHOUT_TORCH, *lines, cwd=folder, env={"PYTHONWARNINGS": "ignore"})


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Walks that were simulated without torch, observers that learnt from one with it, and what
    becomes of them without."""
    folder = tmp_path_factory.mktemp("without_torch")
    course_file(folder, 12.0, "turn = 0.2\n[ranges]\nspeed = [0.8, 1.2]\n")
    done = run(["simulate short.toml --seeds 0:2 -o walks"], folder)
    assert done.returncode == 0, done.stderr
    for model, loss in {**MODELS, "rnn": "mse"}.items():
        plan = TrainSettings(model=model, loss=loss, inputs="gyro,contact,feet", steps=20, every=20)
        train(Log.read(folder / LOG), settings=plan).save(folder / f"{model}.safetensors")
    copy(OLD, folder / "old.pt")
    lines = [
        f"export {LOG} -o log.csv",
        "import log.csv --guess --robot spot_class -o map.toml",
        "import log.csv --map map.toml -o back.parquet",
        *(f"calibrate {m}.safetensors {OTHER} --K 20 -o {m}.json" for m in MODELS),
        f"estimate {LOG} --filter coverage {LEARNT} -o coverage.parquet",
        f"compare {LOG} {LEARNT} -o compared",
        f"loop {LOG} -o looped",
    ]
    done = run(lines, folder)
    assert done.returncode == 0, done.stderr
    (folder / "said.txt").write_text(done.stdout)
    return folder


def test_what_does_not_train_needs_no_torch(folder):
    made = ("back.parquet", "coverage.tum", "looped/report.html")
    assert all((folder / name).stat().st_size > 0 for name in made)
    table = (folder / "compared" / "table.csv").read_text()
    assert all(f",{name}," in table for name in ("coverage", "velocity", "leg"))


def test_a_loop_compares_the_filters_that_need_no_observer_and_says_why(folder):
    table = (folder / "looped" / "table.csv").read_text()
    assert "\nleg," in table
    assert "coverage," not in table
    assert (folder / "said.txt").read_text().count("PyTorch") == 1


def test_what_needs_torch_says_how_to_get_it(folder):
    lines = [
        f"train {LOG} -o new.safetensors",
        f"calibrate rnn.safetensors {OTHER} -o bounds.json",
        "demo -o demo",
        "export old.pt -o new.safetensors",
    ]
    said = run(lines, folder).stderr.strip().split("\0")
    assert len(said) == len(lines)
    assert all("download.pytorch.org/whl/cpu" in one and "\n" not in one for one in said)
    assert "rnn.safetensors" in said[1]


def test_an_earlier_observer_names_the_command_that_converts_it(folder):
    done = run([f"compare {LOG} --observer old.pt -o new"], folder)
    assert "surefoot export old.pt -o" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
