"""The filters' parameters by robot: read whole, or one line says what is wrong."""

import pytest
from refusals import refused

from surefoot.scenarios.estimate.run import ESTIMATORS, estimator_named
from surefoot.scenarios.estimate.settings import BUNDLED_PARAMETERS, read_tuned, tuned
from surefoot.scenarios.tune import write_tuned
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.robot import Robot


def test_every_filter_has_its_own_parameters_for_every_robot():
    for robot in ("v60_class", "spot_class", "default"):
        found = read_tuned().get(robot, read_tuned()["default"])
        assert set(found.filters) <= set(ESTIMATORS)
        for name in ESTIMATORS:
            one = estimator_named(name)
            values = found.of(one)
            assert list(values) == [parameter.name for parameter in one.parameters]
            assert all(value > 0 for value in values.values())
            assert all(part.unit and part.meaning for part in one.parameters)
    leg = estimator_named("leg")
    assert read_tuned()["v60_class"].of(leg)["contact"] == 0.01
    assert read_tuned()["default"].of(leg)["contact"] == 0.02
    assert tuned(Robot.load("v60_class")) == read_tuned()["v60_class"]


def test_what_is_written_is_read_again(tmp_path):
    path = tmp_path / "tuned.toml"
    write_tuned(path, read_tuned())
    assert read_tuned(path) == read_tuned()
    refused("exists", write_tuned, path, read_tuned())


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("mounting", "mountings", r"\[default\] must have mounting"),
        ("[default]", "[other]", "is missing"),
        ("leg = {", "leg = 3 #", r"\[v60_class\] leg must be a table"),
        ("contact = ", "contact = -", r"contact must be .*> 0"),
    ],
)
def test_a_bad_file_is_one_line(tmp_path, old, new, said):
    path = tmp_path / "tuned.toml"
    path.write_text(BUNDLED_PARAMETERS.read_text().replace(old, new))
    refused(said, read_tuned, path)


def test_a_parameter_that_nobody_has_is_one_line(tmp_path):
    path = tmp_path / "tuned.toml"
    path.write_text(BUNDLED_PARAMETERS.read_text().replace("leg = { contact", "leg = { contacts"))
    with pytest.raises(
        SurefootError, match="leg: unknown parameter 'contacts'; known: accel, gyro"
    ):
        read_tuned(path)["v60_class"].of(estimator_named("leg"))


def test_files_of_0_1_0_are_read(tmp_path):
    path = tmp_path / "tuned.toml"
    path.write_text(
        '[default]\nreason = "by hand"\nmounting = 0\n'
        "coverage_persistent = { accel = 0.03, gyro = 0.0003, lasting = 2 }\n"
    )
    found = read_tuned(path)["default"].of(estimator_named("coverage_persistent"))
    assert found == {
        **{"accel": 0.03, "gyro": 0.0003, "persistent": 2.0},
        **{"accel_walk": 1e-4, "gyro_walk": 1e-5},  # not known in 0.1.0: the defaults
    }
