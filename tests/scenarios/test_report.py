"""Reports, pages and their tables: whole, escaped, and stale once their code differs."""

import csv
import re
from dataclasses import replace
from io import StringIO

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused
from web_page import Page

from surefoot.scenarios.reporting.html import (
    Picture,
    Section,
    Step,
    html_report,
    markdown_report,
    write_report,
)
from surefoot.scenarios.reporting.pages import (
    Origin,
    origin_of,
    read_origin,
    write_page,
)
from surefoot.scenarios.reporting.plotting import new_figure
from surefoot.scenarios.reporting.tables import cell, to_csv, to_html, to_markdown

TABLE = [
    {"filter": "Leg | IEKF", "APE [m]": 1.23456, "ok": True},
    {"filter": "<b>", "APE [m]": float("nan"), "ok": None},
]


def test_a_report_needs_no_network_and_no_other_file(tmp_path):
    figure, axes = new_figure()
    axes[0, 0].plot([0, 1])
    path = tmp_path / "report.html"
    write_report(path, "T", [Section("H", "P", TABLE, (Picture(figure, "C"),))])
    text = path.read_text(encoding="utf-8")
    page = Page(text)
    assert page.tags.count("img") == 1
    assert all(a.startswith(("data:image/png;base64,", "#")) for a in page.addresses)
    assert "@import" not in text
    assert not re.search(r"url\(|<script|<link", text)
    refused("exists already", write_report, path, "T", [])


@given(st.text(st.characters(exclude_categories=("Cs", "Cc")), max_size=30))
def test_any_text_comes_out_as_it_went_in(text):
    section = Section(text, text, [{text: text}], (Picture(b"", text),), steps=(Step(text, text),))
    page = Page(html_report(text, [section]))
    assert page.text.count(text) >= 7
    assert page.tags.count("script") == 0
    plain = Section("a", "a", TABLE, (Picture(b"", ""),), steps=(Step("a", "a"),))
    assert set(page.tags) <= set(Page(html_report("a", [plain])).tags)


def test_csv_keeps_every_digit():
    frame = pd.DataFrame({"x": [0.1 + 0.2, np.nan], "name": ["a,b", 'c"d']})
    rows = list(csv.DictReader(StringIO(to_csv(frame))))
    assert float(rows[0]["x"]) == 0.1 + 0.2
    assert rows[1]["x"] == ""
    assert [row["name"] for row in rows] == ["a,b", 'c"d']


def test_html_sets_numbers_apart():
    assert '<td class="number">1.235</td>' in to_html(TABLE)
    best = to_html([{"error": 0.2}, {"error": "**0.100**"}, {"error": "**1.2e-04**"}])
    assert '<td class="number"><strong>0.100</strong></td>' in best
    assert '<td class="number">0.200</td>' in best
    assert "---:" in to_markdown(TABLE)


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (1.23456, "1.235"), (12345.678, "12346"), (-2.5e9, "-2.5e+09"), (1.2e-5, "1.2e-05"),
        (0.0, "0.000"), (None, "–"), (np.nan, "–"), (np.bool_(False), "no"), (np.int64(7), "7"),
    ],
)  # fmt: skip
def test_a_cell_reads_well(value, said):
    assert cell(value) == said


MODULE = "surefoot.scenarios.reporting.tables"


def test_a_page_names_what_made_it_and_is_read_back(tmp_path):
    path = tmp_path / "some.md"
    origin = origin_of(MODULE, "surefoot some --seed 3")
    section = Section("Errors", "Two.", [{"a | b": 1.5}], (Picture(new_figure()[0], "A box."),))
    write_page(path, "Some study", [section], origin)
    assert read_origin(path) == origin
    assert origin.commit
    assert "[![Errors](some_1.png)](some_1.png)\n\nA box." in path.read_text()
    assert (tmp_path / "some_1.png").read_bytes().startswith(b"\x89PNG")


def test_further_tables_are_files_that_the_page_links_to(tmp_path):
    page = tmp_path / "docs" / "results" / "some.md"
    rows = [{"leg": "FL", "error": 0.123456789}, {"leg": "FR", "error": None}]
    picture = Picture(new_figure()[0], "A box.")
    sections = [
        Section("Findings", "The error is small. It was larger.", [{"error": 0.12}]),
        Section("By leg", "One row a leg.\n\nMore.", rows, (picture,), file="legs"),
    ]
    write_page(page, "Some", sections, Origin(commit="1234567"))
    text = page.read_text()
    assert "- [By leg](../data/some/legs.csv): One row a leg.\n" in text
    assert "## By leg\n\n[![By leg](some_1.png)]" in text
    assert "FL" not in text
    table = pd.read_csv(tmp_path / "docs" / "data" / "some" / "legs.csv")
    pd.testing.assert_frame_equal(table, pd.DataFrame(rows))


def test_a_table_of_a_page_replaces_no_other_file(tmp_path):
    mine = tmp_path / "some" / "legs.csv"
    mine.parent.mkdir()
    mine.write_text("mine")
    section = Section("L", "", [{"a": 1}], file="legs")
    page = tmp_path / "some.md"
    refused(r"legs\.csv is another file", write_page, page, "S", [section], Origin())
    assert mine.read_text() == "mine"
    assert not page.exists()


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


def test_steps_are_numbered_and_what_is_folded_is_opened_by_its_heading():
    steps = Step("Look", "surefoot info a.parquet"), Step("Think")
    sections = [Section("A", steps=steps), Section("C", "said", folded=True)]
    page = Page(html_report("T", sections))
    shown = [t for t in page.tags if t in ("li", "pre", "section", "details", "summary")]
    assert shown == ["section", "li", "pre", "li", "details", "summary"]
    text = markdown_report("T", sections)
    assert text.index("1. Look") < text.index("surefoot info a.parquet") < text.index("2. Think")
