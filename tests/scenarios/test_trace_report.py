"""What the report of a trace says of channels and sizes, and where it stands in other reports."""

import pandas as pd

from surefoot.models.attribution.data import LACKING
from surefoot.models.attribution.effect_sizes import Found
from surefoot.scenarios.demo import _loop_sections
from surefoot.scenarios.reporting.tables import as_frame
from surefoot.scenarios.trace.filters import DEAD_RECKONING, REPORTED
from surefoot.scenarios.trace.loop_report import _of_trace
from surefoot.scenarios.trace.report import _note_lines, _sizes, sections
from surefoot.scenarios.trace.result import Trace
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
    trace = Trace(verdict="attributed", channels={}, filters={})
    one = Found(effect("imu_rotation", "y", 0.035012), (0.034642, 0.035381))
    (row,) = _sizes(trace, [one])
    assert (row["low"], row["value"], row["high"]) == ("0.03464", "0.03501", "0.03538")


def test_a_trace_stands_below_the_loop_that_it_is_a_part_of():
    filters = {"leg": {side: dict.fromkeys(REPORTED, 0.1) for side in ("before", "after")}}
    found = Trace(verdict="no_residual", channels={}, filters=filters)
    loop, *trace = _loop_sections(found, effect("gyro_scale", "x", 0.02))
    assert loop.level == 2
    assert [section.heading for section in trace] == ["Verdict", "Filters before and after"]
    assert {section.level for section in trace} == {3}
    channel = {"before": 2.0, "after": 1.0, "noise_floor": 1.0, "unit": "m"}
    held_out = {"against": [], "channels": {"imu": channel}}
    said = {"reasons": [], "channels": {"imu": channel}, "holdout": held_out}
    levels = [(section.heading, section.level) for section in _of_trace(said)]
    assert levels == [("The trace", 2), ("Residuals", 3), ("Held-out logs", 3)]


def test_dead_reckoning_has_no_attitude_of_its_own_to_judge():
    filters = {
        name: {side: dict.fromkeys(REPORTED, 0.1) for side in ("before", "after")}
        for name in ("leg", DEAD_RECKONING)
    }
    found = Trace(verdict="no_residual", channels={}, filters=filters)
    leg, reckoned = as_frame(sections(found)[-1].table or []).to_dict("records")
    assert None not in leg.values()
    shown = {name.rsplit(" ", 1)[0] for name, value in reckoned.items() if not pd.isna(value)}
    assert shown == {"filter", "APE [m]", "RPE [m]", "drift [m/m]", "velocity [m/s]"}
