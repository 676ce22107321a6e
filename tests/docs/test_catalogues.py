"""Pages that list filters, effects and keys: each is there, with its unit or meaning."""

import sys
from dataclasses import fields
from pathlib import Path

import pytest
from catalogues import effects_page, filters_page
from keys import keys, keys_page

from surefoot.scenarios.estimate.estimators import ESTIMATORS
from surefoot.sim import scenario
from surefoot.sim.effects import CATALOGUE
from surefoot.sim.gait.options import GaitOptions
from surefoot.sim.ground.ground_from_file import GroundFile
from surefoot.sim.importing import columns, map, sections
from surefoot.sim.sensors.streams import Sensors

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "docs"))


def rows(page: str) -> list[list[str]]:
    """The cells of all tables of a page."""
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in page.splitlines()]


def test_each_filter_has_its_needs_and_each_parameter_its_filters():
    found = rows(filters_page())
    needs = {row[0]: row[2] for row in found if len(row) == 3}
    assert {f"`{name}`" for name in ESTIMATORS} <= set(needs)
    assert needs["`leg`"] == "imu, contact, feet"
    assert ["`slip_gate`", "16.27", "1"] in [row[:3] for row in found]
    contact = next(row for row in found if row[:1] == ["`contact`"])
    assert contact[4] == "`leg`, `leg_slip`, `radar_leg`"


def test_each_effect_has_its_unit_bounds_and_target():
    found = {row[0]: row[2:] for row in rows(effects_page()) if len(row) == 6}
    assert {f"`{name}`" for name in CATALOGUE} <= set(found)
    assert found["`payload`"] == ["kg", "0", "30", "all"]
    assert found["`backlash`"][3] == "a joint (`FL_calf`) or a group"
    assert found["`encoder_offset`"][3] == "a joint (`FL_calf`)"


sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "docs"))


KINDS = [
    map.MapFile,
    columns.ColumnEntry,
    sections.Source,
    sections.Long,
    sections.ReferenceTable,
    sections.RobotTable,
    sections.ContactTable,
    sections.GroundTable,
    sections.MotorLaw,
    sections.EvenTable,
    scenario._File,
    scenario._SegmentEntry,
    scenario._GroundTable,
    scenario._PatchEntry,
    scenario._StripEntry,
    GroundFile,
    scenario.Ranges,
    GaitOptions,
    Sensors,
]


@pytest.mark.parametrize("kind", KINDS)
def test_every_key_is_listed_with_its_meaning(kind):
    found = keys(kind)
    assert {key for key, *_ in found} == {one.name for one in fields(kind)} - {"bumps"}
    assert all(len(meaning) >= 1 for *_, meaning in found), found
    page = keys_page("Title", "Words.", [("[table]", kind)])
    assert page.count("\n| `") == len(found)
    assert not any("[" in value for _, value, *_ in found)
