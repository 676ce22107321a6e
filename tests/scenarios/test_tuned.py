"""The filters' parameters by robot: read whole, or one line says what is wrong."""

import pytest

from surefoot.scenarios.estimate.registry import FILTERS
from surefoot.scenarios.estimate.tuned import BUNDLED, OWN, read_tuned, tuned
from surefoot.scenarios.tune import write_tuned
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.robot import Robot


def test_every_filter_has_its_own_parameters_for_every_robot():
    assert set(OWN) == set(FILTERS)
    for robot in ("v60_class", "spot_class", "default"):
        found = read_tuned().get(robot, read_tuned()["default"])
        assert all(set(found.filters[name]) == set(own) for name, own in OWN.items())
    assert tuned(Robot.load("v60_class")) is read_tuned()["v60_class"]


def test_what_is_written_is_read_again(tmp_path):
    path = tmp_path / "tuned.toml"
    write_tuned(path, read_tuned())
    assert read_tuned(path) == read_tuned()
    with pytest.raises(SurefootError, match="exists"):
        write_tuned(path, read_tuned())


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("mounting", "mountings", r"must have coverage"),
        ("[default]", "[other]", "is missing"),
        ("slip_gate", "gate", "leg_slip must have accel, gyro, contact, slip_gate"),
        ("accel = ", "accel = -", r"coverage.accel = -.* must be > 0"),
    ],
)
def test_a_bad_file_is_one_line(tmp_path, old, new, said):
    path = tmp_path / "tuned.toml"
    path.write_text(BUNDLED.read_text().replace(old, new))
    with pytest.raises(SurefootError, match=said) as caught:
        read_tuned(path)
    assert "\n" not in str(caught.value)
