"""What the report of a trace says of channels and sizes, and where it stands in other reports."""

import pandas as pd

from surefoot.models.attribution.effect_sizes import Found
from surefoot.scenarios.reporting.tables import as_frame
from surefoot.scenarios.trace.filters import DEAD_RECKONING, REPORTED
from surefoot.scenarios.trace.report import _sizes, sections
from surefoot.scenarios.trace.result import Trace
from surefoot.sim.effects import effect


def test_an_interval_has_digits_that_tell_its_ends_apart():
    trace = Trace(verdict="attributed", channels={}, filters={})
    one = Found(effect("imu_rotation", "y", 0.035012), (0.034642, 0.035381))
    (row,) = _sizes(trace, [one])
    assert (row["low"], row["value"], row["high"]) == ("0.03464", "0.03501", "0.03538")


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
