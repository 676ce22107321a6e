"""Models of robots that others drew: legs, soles and torque limits as published."""

import pytest

from studies.measured import measured_folder
from surefoot.sim.robot import Robot

MODELS = measured_folder().parent / "models"
ICUB = measured_folder() / "icub_biped" / "icub.urdf"


@pytest.mark.parametrize(
    ("file", "limits"),
    [
        ("anybotics_anymal_b/anymal_b.xml", (40.0, 40.0, 40.0)),
        ("anybotics_anymal_c/anymal_c.xml", (80.0, 80.0, 80.0)),
        ("unitree_a1/a1.xml", (33.5, 33.5, 33.5)),
        ("unitree_go1/go1.xml", (23.7, 23.7, 35.55)),
    ],
)
def test_servos_control_ranges_are_angles_and_no_torques(file, limits):
    if not MODELS.is_dir():
        pytest.skip(f"no models in {MODELS}")
    robot = Robot.load(MODELS / file)
    assert robot.limbs.legs == ("FL", "FR", "RL", "RR")
    assert robot.torque_limit.reshape(4, 3).tolist() == [list(limits)] * 4


def test_a_humanoid_from_its_urdf():
    """Its base's x axis points backward: the left leg is the one whose joints are named so."""
    if not ICUB.is_file():
        pytest.skip(f"no {ICUB}")
    icub = Robot.load(ICUB)
    assert icub.mass == pytest.approx(33.1, abs=0.05)
    assert icub.foot_bodies == ("l_sole", "r_sole")
    assert icub.limbs.legs == ("left", "right")
    assert [len(chain) for chain in icub.limbs.chains] == [6, 6]
    assert len(icub.limbs.joints) == 32
    assert icub.limbs.kinds["knee"] == ("l_knee", "r_knee")
    assert icub.torque_limit[0] == 55.5
