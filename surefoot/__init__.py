"""A testbed for proprioceptive-only legged state estimation: simulate, estimate, trace.

Everything named here is imported when it is first used, so that `import surefoot` is quick.
"""

# ruff: noqa: F401
from typing import TYPE_CHECKING

from surefoot.lazy import lazy_names

__version__ = "0.2.0.dev0"

if TYPE_CHECKING:
    from surefoot.estimator.metrics import evaluate
    from surefoot.models.alignment.alignment import Alignment, align, aligned_log
    from surefoot.models.calibration.bounds import Bounds
    from surefoot.models.calibration.calibrate import calibrate
    from surefoot.models.calibration.settings import CalibrateSettings
    from surefoot.models.observer.observer import Observer
    from surefoot.models.observer.settings import TrainSettings
    from surefoot.models.observer.training import train
    from surefoot.scenarios.compare import compare_log as compare
    from surefoot.scenarios.datasets.simulate import simulate
    from surefoot.scenarios.estimate.contract import Learnt, Sample
    from surefoot.scenarios.estimate.run import run_filter
    from surefoot.scenarios.estimate.settings import FilterSettings, NoiseSettings, StartSettings
    from surefoot.scenarios.estimate.streaming import StreamingEstimator
    from surefoot.scenarios.settings import SimulateSettings
    from surefoot.scenarios.trace.report import summary as trace_summary
    from surefoot.scenarios.trace.result import Trace
    from surefoot.scenarios.trace.run import TraceOptions, trace
    from surefoot.sim.importing.assemble import RawRecording
    from surefoot.sim.importing.recording import import_log, read_recording
    from surefoot.sim.log import Log
    from surefoot.sim.plausibility import check_log
    from surefoot.sim.robot.machine import load_machine
    from surefoot.sim.robot.robot import Robot
    from surefoot.sim.scenario import Scenario
    from surefoot.sim.walk import walk

__getattr__, __dir__ = lazy_names(globals())
