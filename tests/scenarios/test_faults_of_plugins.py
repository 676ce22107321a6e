"""What a plug-in of any kind does wrong while it runs is an error that names it, not a result."""

import numpy as np
import pytest
import torch
from own_package import forget_plugins
from synthetic import synthetic_walk

from surefoot import Bounds, Robot, run_filter
from surefoot.extend import SurefootError, compensate_all, effect
from surefoot.models.attribution.evidence import log_under_model
from surefoot.models.calibration.regions import calibrator, errors_needed
from surefoot.models.observer.network import Network
from surefoot.models.residuals.channels import CHANNELS
from surefoot.models.residuals.layout import residual
from surefoot.sim.common import plugins as plugins_module
from surefoot.sim.common.plugins import exits_raised, load_plugin, naming_plugins
from surefoot.sim.gait.options import pattern_named

SOURCES = {
    "estimators": """
from dataclasses import replace
from surefoot.extend import Update
from surefoot.scenarios.estimate.bundled import Imu
class Mine(Imu):
    name = "mine"
    def start(self, *begun):
        return Stream(super().start(*begun))
class Stream:
    def __init__(self, inner):
        self.inner = inner
    def step(self, sample):
        self.inner.step(sample)
    state = property(lambda self: self.inner.state)
    covariance = property(lambda self: self.inner.covariance)
""",
    "effects": """
from surefoot.extend import Effect, Traced
class Mine(Effect):
    name, unit, bounds, targets = "mine", "1", (0.0, 1.0), ("all",)
    traced = Traced(channels=("imu_gyro",), step=0.1)
    def compensate(self, log, robot):
        return log, robot
""",
    "channels": """
from surefoot.extend import Channel, Column
class Mine(Channel):
    name, unit, needs, on_given_feet = "mine", "1", (), True
    def columns(self, limbs):
        return tuple(Column(name, "1", "mine", "mine") for name in ("mine_a", "mine_b"))
    def residual(self, inputs):
        return np.zeros((len(inputs.motion.t), 2))
    def noise(self, sensors, rate, evenness):
        return 1.0
""",
    "architectures": """
import torch
class Mine(torch.nn.Module):
    width, rate, receptive_field, causal, features = 4, 0.1, 1, True, 3
    def __init__(self, inputs, width):
        super().__init__()
    def initialise(self, generator):
        pass
    def forward(self, x):
        return x[..., :3]
    def stepper(self):
        return lambda x: x[:3]
""",
    "calibrators": """
from surefoot.extend import Calibrator
class Mine(Calibrator):
    label = "mine"
    def conformalize(self, errors):
        self.epsilon = np.ones(3)
""",
    "gaits": """
class Mine:
    phase, duty, period = (0.0, 0.5, 0.5, 0.0), 0.6, 1.2
""",
}
"""Kind of plug-in -> its source, of which a case replaces a part."""


@pytest.fixture(scope="module")
def log():
    return synthetic_walk(0, 2.0)


@pytest.fixture
def offer(tmp_path, monkeypatch):
    """A function that makes a plug-in file of a kind, with lines after its class."""
    for name, empty in (("_LOADED", {}), ("_IN_USE", {}), ("_OF_FILES", {})):
        monkeypatch.setattr(plugins_module, name, empty)
    monkeypatch.setenv(plugins_module.FILES, "")

    def make(kind: str, more: str) -> None:
        path = tmp_path / "mine.py"
        offered = f"PLUGINS = {{'surefoot.{kind}': {{'mine': Mine}}}}"
        path.write_text(f"import os\nimport numpy as np\n{SOURCES[kind]}\n{more}\n{offered}\n")
        load_plugin(path)
        forget_plugins()

    yield make
    forget_plugins()


def estimators(log):
    run_filter("mine", log, None)


def effects(log):
    log, _ = compensate_all([effect("mine", "all", 0.5)], log, Robot.load("spot_class"))
    run_filter("imu", log, None)


def residual_channels(log):
    assert CHANNELS["mine"]
    case = log_under_model(log, Robot.load("spot_class"))
    residual(case.log, case.robot, case.motion, ["mine"])


def architectures(log):
    body = Network("mine", 5, 3, 4)
    body.initialise(torch.Generator())
    body(torch.ones(7, 2, 5))


def calibrators(log):
    how = calibrator("mine", 0.8)
    errors_needed(how)
    how.conformalize(np.ones((30, 3)))
    Bounds(how.bounds().epsilon, 0.8, how.level, "mine", 1, 30, "observer", np.eye(3), log.name)


def gaits(log):
    pattern_named("mine")


RUNS = {
    "estimators": estimators,
    "effects": effects,
    "channels": residual_channels,
    "architectures": architectures,
    "calibrators": calibrators,
    "gaits": gaits,
}
STEP = "Stream.step = lambda self, sample:"
STATE = "Stream.state = property(lambda self:"
COVARIANCE = "Stream.covariance = property(lambda self:"
FAULTS = [
    ("estimators", "Mine.start = lambda *args: 1 / 0", "ZeroDivisionError"),
    ("estimators", "Mine.__init__ = lambda self: os._exit(0)", "SystemExit"),
    ("estimators", "Mine.prepare = lambda self, log, robot: log.rows(slice(0, 99))", "rows"),
    ("estimators", f"{STEP} exit(0)", "SystemExit"),
    ("estimators", f"{STEP} Update(np.zeros(2))", "v_I"),
    ("estimators", f"{STEP} Update(np.full(3, np.nan))", "not finite"),
    ("estimators", f"{STATE} replace(self.inner.state, p_GI=np.full(3, np.nan)))", "not finite"),
    ("estimators", f"{COVARIANCE} np.full((15, 15), np.nan))", "not finite"),
    ("estimators", f"{COVARIANCE} np.eye(14))", "reshape"),
    ("estimators", "Stream.run = lambda self, log, rows, more: None", "NoneType"),
    ("estimators", "Mine.name = 'other'", "calls itself other"),
    ("effects", "Mine.compensate = lambda self, log, robot: (None, robot)", "NoneType"),
    ("effects", "Mine.bounds = None", "NoneType"),
    ("effects", "Mine.traced = Traced(channels=('imu_gyro',), step=-1.0)", "step"),
    ("effects", "Mine.traced = Traced(step=0.1)", "channels"),
    ("effects", "Mine.step, Mine.lossy = 0.1, True", "step, lossy: to be stated by traced"),
    ("channels", "Mine.residual = lambda self, inputs: np.zeros((3, 3))", "shape"),
    ("architectures", "Mine.forward = lambda self, x: None", "NoneType"),
    ("architectures", "Mine.forward = lambda self, x: x", "mat1"),
    ("calibrators", "Mine.fit_share = 1.0", "fit_share"),
    ("calibrators", "Mine.samples_needed = lambda self: None", "number"),
    ("calibrators", "Mine.conformalize = lambda self, errors: None", "epsilon"),
    ("calibrators", "Mine.bounds = lambda self: None", "NoneType"),
    ("calibrators", "Mine.epsilon = np.full(3, -1.0)\nMine.conformalize = Mine.fit", "positive"),
    ("calibrators", "Mine.level = 2.0", "level"),
    ("gaits", "Mine.sway = np.nan", "sway"),
    ("gaits", "Mine.phase = (0.0, np.nan, 0.0, 0.0)", "phase"),
]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("kind", "more", "words"), FAULTS)
def test_a_fault_of_a_plug_in_is_one_line_that_names_it(offer, log, kind, more, words):
    offer(kind, more)
    with pytest.raises(SurefootError) as caught, naming_plugins(), exits_raised():
        RUNS[kind](log)
    said = str(caught.value)
    assert f"plugin mine = surefoot_plugin_mine:Mine (surefoot.{kind})" in said
    assert words in said
    assert "\n" not in said


@pytest.mark.parametrize("kind", RUNS)
def test_without_a_fault_it_runs(offer, log, kind):
    offer(kind, "")
    with naming_plugins(), exits_raised():
        RUNS[kind](log)


def test_a_plug_in_that_writes_over_its_input_spoils_only_its_own(offer, log):
    offer("architectures", "Mine.forward = lambda self, x: x.zero_()[..., :3]")
    x = torch.ones(7, 2, 5)
    Network("mine", 5, 3, 4)(x)
    assert (x == 1.0).all()
    offer(
        "effects",
        "def compensate(self, log, robot):\n    log.frame['gyro_x'] = 0.0\n    return log, robot\n"
        "Mine.compensate = compensate",
    )
    before = log.frame.copy()
    one = effect("mine", "all", 0.5)
    seen, _ = compensate_all([one], log, Robot.load("spot_class"))
    assert (seen.gyro[:, 0] == 0.0).all()
    assert log.frame.equals(before)
