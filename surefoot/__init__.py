"""A testbed for proprioceptive-only legged state estimation: simulate, estimate, trace.

Everything named here is imported when it is first used, so that `import surefoot` is quick.
"""

from typing import TYPE_CHECKING

from surefoot.lazy import lazy_names

__version__ = "0.2.0.dev0"

if TYPE_CHECKING:
    from surefoot.estimator.metrics import evaluate
    from surefoot.models.alignment.alignment import align
    from surefoot.models.calibration.bounds import Bounds
    from surefoot.models.calibration.calibrate import calibrate
    from surefoot.models.calibration.settings import CalibrateSettings
    from surefoot.models.observer.observer import Observer
    from surefoot.models.observer.settings import TrainSettings
    from surefoot.models.observer.training import train
    from surefoot.scenarios.compare import compare_log as compare
    from surefoot.scenarios.estimate.contract import Learnt, Sample
    from surefoot.scenarios.estimate.run import run_filter
    from surefoot.scenarios.estimate.streaming import StreamingEstimator
    from surefoot.scenarios.trace.run import TraceOptions, trace
    from surefoot.sim.log import Log
    from surefoot.sim.robot.robot import Robot
    from surefoot.sim.scenario import Scenario
    from surefoot.sim.walk import walk

__all__ = [
    "Bounds",
    "CalibrateSettings",
    "Learnt",
    "Log",
    "Observer",
    "Robot",
    "Sample",
    "Scenario",
    "StreamingEstimator",
    "TraceOptions",
    "TrainSettings",
    "__version__",
    "align",
    "calibrate",
    "compare",
    "evaluate",
    "run_filter",
    "trace",
    "train",
    "walk",
]

_HOMES = {
    "estimator.metrics": ("evaluate",),
    "models.alignment.alignment": ("align",),
    "models.calibration.bounds": ("Bounds",),
    "models.calibration.calibrate": ("calibrate",),
    "models.calibration.settings": ("CalibrateSettings",),
    "models.observer.observer": ("Observer",),
    "models.observer.settings": ("TrainSettings",),
    "models.observer.training": ("train",),
    "scenarios.compare": ("compare_log as compare",),
    "scenarios.estimate.contract": ("Learnt", "Sample"),
    "scenarios.estimate.run": ("run_filter",),
    "scenarios.estimate.streaming": ("StreamingEstimator",),
    "scenarios.trace.run": ("TraceOptions", "trace"),
    "sim.log": ("Log",),
    "sim.robot.robot": ("Robot",),
    "sim.scenario": ("Scenario",),
    "sim.walk": ("walk",),
}
__getattr__, __dir__ = lazy_names(globals(), _HOMES)
