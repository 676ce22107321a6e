"""Pages of results say what made them and when they have gone stale; finished cases are kept."""

import json
from dataclasses import replace

import pandas as pd
import pytest

from surefoot.scenarios.cache import finished_case
from surefoot.scenarios.reporting.html import Picture, Section
from surefoot.scenarios.reporting.pages import (
    Origin,
    origin_of,
    read_origin,
    tables_folder,
    write_page,
)
from surefoot.scenarios.reporting.plotting import new_figure
from surefoot.sim.common.errors import SurefootError

MODULE = "surefoot.scenarios.reporting.tables"


def test_a_page_names_what_made_it_and_is_read_back(tmp_path):
    path = tmp_path / "some.md"
    origin = origin_of(MODULE, "surefoot some --seed 3")
    section = Section("Errors", "Two.", [{"a | b": 1.5}], (Picture(new_figure()[0], "A box."),))
    write_page(path, "Some study", [section], origin)
    assert read_origin(path) == origin
    assert origin.commit
    assert origin.machine.endswith("cores")
    text = path.read_text()
    assert text.startswith("# Some study\n\n## Errors\n\nTwo.\n\n")
    assert "## Errors\n\nTwo.\n\n| a \\| b |" in text
    assert "[![Errors](some_1.png)](some_1.png)\n\nA box." in text
    assert (tmp_path / "some_1.png").read_bytes().startswith(b"\x89PNG")


def test_further_tables_are_files_that_the_page_links_to(tmp_path):
    page = tmp_path / "docs" / "results" / "some.md"
    rows = [{"leg": "FL", "error": 0.123456789}, {"leg": "FR", "error": None}]
    picture = Picture(new_figure()[0], "A box.")
    sections = [
        Section("Findings", "The error is small. It was larger.", [{"error": 0.12}]),
        Section("By leg", "One row a leg.\n\nMore.", rows, (picture,), file="legs"),
        Section("Nothing", "No rows.", file="none"),
    ]
    write_page(page, "Some", sections, Origin(commit="1234567"))
    text = page.read_text()
    assert "- [By leg](../data/some/legs.csv): One row a leg.\n" in text
    assert "## By leg\n\n[![By leg](some_1.png)]" in text
    assert "FL" not in text
    assert "Nothing" not in text
    table = pd.read_csv(tmp_path / "docs" / "data" / "some" / "legs.csv")
    pd.testing.assert_frame_equal(table, pd.DataFrame(rows))
    elsewhere = tmp_path / "page.md"
    assert tables_folder(elsewhere) == tmp_path / "page"


def test_a_table_of_a_page_replaces_no_other_file(tmp_path):
    mine = tmp_path / "some" / "legs.csv"
    mine.parent.mkdir()
    mine.write_text("mine")
    with pytest.raises(SurefootError, match=r"legs\.csv is another file"):
        write_page(tmp_path / "some.md", "S", [Section("L", "", [{"a": 1}], file="legs")], Origin())
    assert mine.read_text() == "mine"
    assert not (tmp_path / "some.md").exists()


def test_a_page_is_stale_once_its_code_differs_or_is_unknown(tmp_path):
    origin = origin_of(MODULE, "x")
    path = tmp_path / "some.md"
    for one, stale in (
        (origin, False),
        (replace(origin, digest="0" * 64), True),
        (Origin(commit="1234567", command="x", module=MODULE), True),
    ):
        write_page(path, "Some study", [], one)
        assert read_origin(path).stale is stale
    path.write_text("# no page of results\n")
    assert read_origin(path) == Origin()


def test_a_case_is_run_once_for_its_inputs_and_code(tmp_path):
    runs = []

    def case(seed: int) -> dict:
        def make():
            runs.append(seed)
            return {"error": 0.5 * seed, "pair": (1, 2)}

        return finished_case(tmp_path, f"case_{seed}", {"seed": seed}, MODULE, make)

    assert case(1) == case(1) == {"error": 0.5, "pair": [1, 2]}
    assert case(2)["error"] == 1.0
    assert runs == [1, 2]
    path = tmp_path / "case_1.json"
    path.write_text(path.read_text()[:-30])  # half a file is none
    assert case(1) == {"error": 0.5, "pair": [1, 2]}
    values = json.loads(path.read_text())
    path.write_text(json.dumps(values | {"code": "another"}))
    case(1)
    assert runs == [1, 2, 1, 1]
