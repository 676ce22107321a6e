"""A measured walk of a humanoid, imported as published, and estimated by its legs."""

import pytest

from studies.measured import measured_folder
from surefoot.scenarios.estimate.run import run_filter
from surefoot.sim.importing.recording import import_log
from surefoot.sim.robot import Robot

RECORDING = measured_folder() / "icub_biped" / "walking.mat"


@pytest.mark.skipif(not RECORDING.is_file(), reason=f"the measured walk is not here ({RECORDING})")
def test_the_leg_filter_follows_a_metre_to_five_centimetres():
    log = import_log(RECORDING, "icub_biped")
    found = run_filter("leg", log, Robot.for_log(log))
    assert found.metrics is not None
    assert found.metrics.rpe_trans < 0.05
    assert found.metrics.ape_trans < 0.05
    assert not found.health.lost
