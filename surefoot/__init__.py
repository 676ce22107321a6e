"""A testbed for proprioceptive-only legged state estimation: simulate, estimate, trace.

Everything named here is imported when it is first used, so that `import surefoot` is quick.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

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
    "Bounds": "surefoot.models.calibration.bounds:Bounds",
    "CalibrateSettings": "surefoot.models.calibration.settings:CalibrateSettings",
    "Learnt": "surefoot.scenarios.estimate.contract:Learnt",
    "Log": "surefoot.sim.log:Log",
    "Observer": "surefoot.models.observer.observer:Observer",
    "Robot": "surefoot.sim.robot.robot:Robot",
    "Sample": "surefoot.scenarios.estimate.contract:Sample",
    "Scenario": "surefoot.sim.scenario:Scenario",
    "StreamingEstimator": "surefoot.scenarios.estimate.streaming:StreamingEstimator",
    "TraceOptions": "surefoot.scenarios.trace.run:TraceOptions",
    "TrainSettings": "surefoot.models.observer.settings:TrainSettings",
    "align": "surefoot.models.alignment.alignment:align",
    "calibrate": "surefoot.models.calibration.calibrate:calibrate",
    "compare": "surefoot.scenarios.compare:compare_log",
    "evaluate": "surefoot.estimator.metrics:evaluate",
    "run_filter": "surefoot.scenarios.estimate.run:run_filter",
    "trace": "surefoot.scenarios.trace.run:trace",
    "train": "surefoot.models.observer.training:train",
    "walk": "surefoot.sim.walk:walk",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'surefoot' has no attribute {name!r}")
    module, _, attribute = _HOMES[name].partition(":")
    value = globals()[name] = getattr(import_module(module), attribute)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
