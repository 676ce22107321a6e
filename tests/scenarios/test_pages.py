"""Pages of results say what made them and when they have gone stale; finished cases are kept."""

import json
from dataclasses import replace

from surefoot.scenarios.cache import finished_case
from surefoot.scenarios.reporting.html import Picture, Section
from surefoot.scenarios.reporting.pages import Origin, origin_of, read_origin, write_page
from surefoot.scenarios.reporting.plotting import new_figure

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
    assert text.startswith("# Some study\n\n| | |\n")
    assert "## Errors\n\nTwo.\n\n| a \\| b |" in text
    assert "![Errors](some_1_1.png)\n\nA box." in text
    assert (tmp_path / "some_1_1.png").read_bytes().startswith(b"\x89PNG")


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


def test_what_was_written_by_hand_goes_when_a_page_is_made_again(tmp_path):
    path = tmp_path / "some.md"
    write_page(path, "Some", [Section("Old")], origin_of(MODULE, "x"))
    path.write_text(f"{path.read_text()}\n0.12 m, typed by hand\n")
    write_page(path, "Some", [Section("New")], origin_of(MODULE, "x"))
    assert path.read_text().endswith("## New\n")
    assert "Old" not in path.read_text()


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
