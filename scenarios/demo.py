"""The whole workflow end to end: walk, learn, calibrate, estimate, compare and trace."""

from dataclasses import replace
from pathlib import Path
from time import perf_counter

import numpy as np
import pandas as pd

from surefoot.models.calibration.empirical_coverage import coverage, relative_errors
from surefoot.models.observer.predict import prediction_errors
from surefoot.models.observer.settings import TrainSettings
from surefoot.scenarios.compare import compare_log, write_comparison
from surefoot.scenarios.estimate.learning import learn
from surefoot.scenarios.estimate.run import Learnt
from surefoot.scenarios.first_use import compile_filters
from surefoot.scenarios.reporting.html import Picture, Section, nested
from surefoot.scenarios.reporting.observer_errors import error_section, mixing_curve
from surefoot.scenarios.reporting.tables import in_terminal
from surefoot.scenarios.stages import percent_bar, processes, submitted
from surefoot.scenarios.trace.report import sections as trace_sections
from surefoot.scenarios.trace.result import Trace
from surefoot.scenarios.trace.run import TraceOptions, trace
from surefoot.scenarios.trace.words import summary
from surefoot.sim.common.errors import check_seed
from surefoot.sim.common.files import check_space, refuse_full, whole_folder
from surefoot.sim.effects import Effect, effect
from surefoot.sim.effects.file import save_effects
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario
from surefoot.sim.walk import plan, walk

DEMO_SPACE = 1e8
"""Bytes that the folder of a demo takes, and a fifth more."""
WALKS = ("train", "calibrate", "walk")

UNDECLARED: tuple[tuple[str, tuple[str, ...], tuple[float, float]], ...] = (
    ("encoder_offset", ("FL_thigh", "FR_calf", "RL_calf", "RR_thigh"), (0.015, 0.05)),
    ("link_length", ("FL_calf", "FR_thigh", "RL_thigh", "RR_calf"), (0.01, 0.03)),
    ("foot_rolling", ("all",), (0.004, 0.01)),
    ("imu_rotation", ("x", "y", "z"), (0.02, 0.06)),
    ("gyro_scale", ("x", "y", "z"), (0.01, 0.03)),
    ("joint_delay", ("all",), (0.003, 0.01)),
)
"""Possible undeclared effects of the traced walk: effect, targets, and range of the size."""


def demo(out: Path, seed: int = 0, force: bool = False) -> pd.DataFrame:
    """Run everything into `out` and print the table; deterministic for a given seed.

    Raises SurefootError where `out` contains files and `force` is not given.
    """
    started = perf_counter()
    check_seed(seed)
    refuse_full(out, force)
    check_space(out, DEMO_SPACE)
    with whole_folder(out, force) as folder:
        results, found, hidden = _run(folder, seed)
    print("\n" + in_terminal(results))
    print(f"\n{summary(found)}\nThe effect was: {_in_words(hidden)}.")
    print(
        f"\n{perf_counter() - started:.0f} s in all. Report: {out / 'report.html'}\n"
        f"See the walk: surefoot view {out / 'walk.rrd'}"
    )
    return results


def _run(out: Path, seed: int) -> tuple[pd.DataFrame, Trace, Effect]:
    """The table, the trace, and the effect it should have found; all files are in `out`."""
    robot = Robot.load("spot_class")
    # The second worker is started only if the first is still compiling when the walks are done.
    with processes(2) as pool:
        assert pool is not None
        # On a fresh machine this process has the kernels of the walks to compile meanwhile.
        submitted(pool, (compile_filters,))
        logs = {role: _walk(role, robot, _seed(role, seed), out) for role in WALKS}
        hidden = _undeclared(robot, seed, out)
        tracing = submitted(pool, (_trace, robot, seed, out))
        print("training two observers on one walk: mean squared error, Gaussian likelihood")
        learnt = learn([logs["train"]], logs["calibrate"], out, TrainSettings(seed=seed))
        print("\nevery filter, on a walk that nothing was trained on")
        comparison = compare_log(logs["walk"], robot, learnt)
        print("\nwaiting for the trace of a walk with an effect that its log does not declare")
        found = tracing.result()
    # The ground as drawn with this seed, in contrast to that in the file.
    ground = plan(Scenario.load("demo/walk"), robot, _seed("walk", seed)).draw.scenario.ground
    extra = [*_observer_sections(logs, learnt), *_loop_sections(found, hidden)]
    title = "surefoot demo: a walk on slippery ground, estimated by proprioception"
    results = write_comparison([comparison], out, title, ground, extra=extra)
    return results, found, hidden


def _seed(role: str, seed: int) -> int:
    """A different seed for each walk: the same robot, started anew, on newly drawn ground."""
    return 4 * seed + WALKS.index(role)


def _walk(role: str, robot: Robot, seed: int, out: Path) -> Log:
    """Simulate the scenario of that name and write its log under it."""
    with percent_bar(f"walking: {role}") as progress:
        log = walk(Scenario.load(f"demo/{role}"), robot, seed, progress=progress)
    path = out / "logs" / f"{role}.parquet"
    log.write(path)
    return Log.read(path)


def _undeclared(robot: Robot, seed: int, out: Path) -> Effect:
    """Simulate another walk with an effect that its log does not declare; returns the effect."""
    rng = np.random.default_rng([seed, 4])
    name, targets, (low, high) = UNDECLARED[rng.integers(len(UNDECLARED))]
    size = float(rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(low), np.log(high))))
    hidden = effect(name, str(rng.choice(targets)), abs(size) if name == "joint_delay" else size)
    with percent_bar("walking: undeclared") as progress:
        scenario, own = Scenario.load("demo/walk"), 4 * seed + 3
        log = walk(scenario, robot, own, [hidden], declared=False, progress=progress)
    replace(log, name="undeclared").write(out / "logs" / "undeclared.parquet")
    save_effects(out / "truth.toml", [hidden])
    return hidden


def _trace(robot: Robot, seed: int, out: Path) -> Trace:
    """Trace that walk from its log alone."""
    log = Log.read(out / "logs" / "undeclared.parquet")
    return trace([log], robot, out / "trace", TraceOptions(seed))


def _in_words(hidden: Effect) -> str:
    return f"{hidden.name} of {hidden.target}, {hidden.value:.4g} {hidden.unit}"


def _loop_sections(found: Trace, hidden: Effect) -> list[Section]:
    hidden_effect = Section(
        "Closing the loop",
        "A further walk was recorded with an effect that its log does not declare; what follows "
        f"was found from the log alone. The effect was: {_in_words(hidden)}.",
    )
    return [hidden_effect, *nested(trace_sections(found))]


def _observer_sections(logs: dict[str, Log], learnt: Learnt) -> list[Section]:
    observer, bounds = learnt.bounded("mse")
    test_errors = prediction_errors(observer, logs["walk"])[1]
    held = coverage(relative_errors(observer, bounds, logs["walk"])[1], bounds)
    pictures = ()
    if bounds.mixing is not None:
        caption = "Correlation of errors over time: calibration samples are taken K steps apart."
        file = "figures/observer_mixing.png"
        pictures = (Picture(mixing_curve(bounds.mixing), caption, file),)
    learning = Section(
        "The observer and its bounds",
        f"Trained on one walk; calibrated on another at joint level {bounds.gamma:g} with "
        f"{bounds.n} errors, {bounds.K} steps of 10 ms apart. On the third walk "
        f"{100 * held.joint:.1f} % of the errors lie within all three bounds (95 % interval "
        f"{100 * held.joint_interval[0]:.0f} to {100 * held.joint_interval[1]:.0f} %).",
        _errors_table(learnt, logs),
        pictures,
    )
    tested = observer.errors, test_errors
    return [learning, error_section(*tested, bounds.epsilon, bounds.gamma, "the third walk")]


def _errors_table(learnt: Learnt, logs: dict[str, Log]) -> list[dict[str, object]]:
    rows: list[dict[str, object]] = []
    for observer, bounds in zip(learnt.observers, learnt.bounds, strict=True):
        for role in WALKS:
            errors = prediction_errors(observer, logs[role])[1]
            rms = np.sqrt((errors**2).mean(axis=0))
            row: dict[str, object] = {"loss": observer.loss, "walk": role}
            for i, axis in enumerate("xyz"):
                row[f"RMSE {axis} [m/s]"] = rms[i]
                row[f"epsilon {axis} [{bounds.unit}]"] = bounds.epsilon[i]
            rows.append(row)
    return rows
