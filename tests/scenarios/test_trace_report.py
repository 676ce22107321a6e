"""What the report of a trace says of channels and sizes."""

from surefoot.models.attribution.data import LACKING
from surefoot.models.attribution.found import Found
from surefoot.scenarios.trace.report import _note_lines, _sizes
from surefoot.sim.effects import effect


def test_channels_that_lack_columns_share_a_sentence():
    notes = [f"foot_height{LACKING}q and contact", "the floor is high", f"command{LACKING}tau"]
    assert _note_lines(notes) == [
        "Note: the floor is high.",
        "Channels not used, and what the log lacks for them: "
        "foot_height (q and contact); command (tau).",
    ]
    assert _note_lines([]) == []


def test_an_interval_has_digits_that_tell_its_ends_apart():
    (row,) = _sizes([Found(effect("imu_rotation", "y", 0.035012), (0.034642, 0.035381))])
    assert (row["low"], row["value"], row["high"]) == ("0.03464", "0.03501", "0.03538")
