"""The notebook runs from its first cell to its last, and was left without outputs."""

import json
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

pytestmark = pytest.mark.long
NOTEBOOK = Path(__file__).parents[2] / "docs/examples/main_job.ipynb"


def test_every_cell_runs_in_order(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    plt.switch_backend("agg")
    cells = json.loads(NOTEBOOK.read_text())["cells"]
    seen: dict = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            assert (cell["outputs"], cell["execution_count"]) == ([], None)
            exec(compile("".join(cell["source"]), f"{NOTEBOOK}:{cell['id']}", "exec"), seen)
    assert len(plt.get_fignums()) == 2
    plt.close("all")
    assert seen["results"]["leg"].metrics.ape_trans < 0.3
    assert "NEES" in capsys.readouterr().out
    for link in (word for cell in cells for word in "".join(cell["source"]).split("](")[1:]):
        assert (NOTEBOOK.parent / link.partition(")")[0]).is_file()
