"""Pages that list the keys of maps and scenarios: every key is there, with its meaning."""

import sys
from dataclasses import fields
from pathlib import Path

import pytest

from surefoot.sim import scenario
from surefoot.sim.gait.options import GaitOptions
from surefoot.sim.ground.ground_from_file import GroundFile
from surefoot.sim.importing import columns, map, sections
from surefoot.sim.sensors.streams import Sensors

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "docs"))
from keys import keys, keys_page

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
