"""The filters' parameters by robot: read whole, or one line says what is wrong."""

import pytest

from scenarios.filters import FILTERS
from scenarios.tuned import BUNDLED, read_tuned, tuned
from sim.errors import SurefootError
from sim.robot import Robot


def test_every_robot_has_parameters_for_every_filter_that_takes_any():
    legs = {"leg", "leg_slip"}
    for values in read_tuned().values():
        assert set(values.accel) <= set(FILTERS)
        assert set(values.contact) == legs <= set(values.accel)
        assert values.inflation >= 1.0
    assert tuned(Robot.load("v60_class")) is read_tuned()["v60_class"]
    assert tuned(Robot.load("spot_class")) is read_tuned()["default"]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [("slip_gate", "gate", r"\[default\] must have accel"), ("[default]", "[other]", "is missing")],
)
def test_a_bad_file_is_one_line(tmp_path, old, new, said):
    path = tmp_path / "tuned.toml"
    path.write_text(BUNDLED.read_text().replace(old, new))
    with pytest.raises(SurefootError, match=said):
        read_tuned(path)
