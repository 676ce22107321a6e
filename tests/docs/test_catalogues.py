"""Pages that list the filters and the effects: each is there, with its unit."""

import sys
from pathlib import Path

from surefoot.scenarios.estimate.estimators import ESTIMATORS
from surefoot.sim.effects import CATALOGUE

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "docs"))
from catalogues import effects_page, filters_page


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
