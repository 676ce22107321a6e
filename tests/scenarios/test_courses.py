"""The courses of the suites are as long as the paper's sequences."""

import numpy as np
import pytest

from surefoot import Scenario
from surefoot.sim.common.files import bundled

FOLDERS = [bundled("surefoot.scenarios", "courses") / suite for suite in ("vision60", "spot")]
# Length [m] and duration [s] of the paper's sequences.
PAPER = {
    "2CC2CCW": (53.15, 76.3), "2CCW2CC": (51.97, 95.57), "3CC3CCW": (74.65, 107.96),
    "3CCW3CC": (83.42, 129.93), "RoomScan": (38.96, 66.97), "Slipped": (19.01, 43.03),
    "Stroll": (99.21, 162.3), "Atrium": (109.93, 124.50), "BiCorridor": (240.82, 277.29),
    "BridgeLoop": (161.17, 187.20), "CorriLoop": (208.68, 229.40), "Downstair": (233.75, 270.90),
    "Overpass": (169.17, 213.49), "Quad": (447.83, 503.69), "SlopeStair": (273.37, 307.49),
    "Tunnel": (247.94, 277.00), "Upstair": (197.22, 227.89),
}  # fmt: skip


def test_every_course_of_the_suites_is_in_the_paper():
    courses = [Scenario.load(path) for folder in FOLDERS for path in folder.glob("*.toml")]
    assert sorted(course.name for course in courses) == sorted(PAPER)
    for course in courses:
        seconds = np.array([part.duration for part in course.segments])
        speeds = np.hypot(*np.transpose([(p.forward, p.lateral) for p in course.segments]))
        length, duration = PAPER[course.name]
        assert course.laps * speeds @ seconds == pytest.approx(length, rel=0.01), course.name
        walked = course.laps * seconds.sum() + 2 * course.stand
        assert walked == pytest.approx(duration, rel=0.03), course.name
