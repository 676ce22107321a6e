"""Close the loop: residual of measured logs -> the effect the model lacks -> before and after."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from surefoot.models.attribution.diagnose import cases_of, diagnose
from surefoot.models.attribution.evidence import LogUnderModel
from surefoot.models.attribution.settings import DEFAULT, TraceSettings
from surefoot.scenarios.estimate.run import Learnt
from surefoot.scenarios.trace.filters import BeforeAfter, before_and_after, mean_metrics
from surefoot.scenarios.trace.report import write_outputs
from surefoot.scenarios.trace.result import Trace
from surefoot.scenarios.trace.words import motion_to_distinguish
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.effects import Effect
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.robot.fixed_base import Machine

OUTPUTS = ("trace.json", "effects.toml", "report.html", "trace.rrd")


def trace(
    logs: Sequence[Log],
    robot: Machine,
    out: Path | str,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
    force: bool = False,
    declared: Sequence[Effect] = (),
    learnt: Learnt | None = None,
    settings: TraceSettings | None = None,
) -> Trace:
    """Find which effect `robot` lacks as a model of the logs, and what adding it changes.

    Args:
        logs: of one machine; time, IMU, joints, feet, reference and rate are read, nothing else.
        robot: the declared model.
        out: folder for trace.json, effects.toml, report.html and trace.rrd.
        seed: of the bootstrap.
        progress: called with the share that is done.
        force: overwrite such files.
        declared: effects that belong to the model: compensated before anything is asked.
        learnt: observers and bounds for the filters that need them.
        settings: thresholds and constants; the defaults where left out.

    Raises SurefootError where `out` has such files (no `force`), and LogError where a log
    has no reference.
    """
    out = Path(out)
    if not logs:
        raise SurefootError("trace: needs at least one log")
    if not force:
        for name in OUTPUTS:
            if (out / name).exists():
                raise SurefootError(f"{out / name}: exists already; give --force to overwrite it")
    found = trace_logs(logs, robot, seed, progress, declared, learnt, settings or DEFAULT)
    write_outputs(found, robot, out, force)
    return found


def trace_logs(
    logs: Sequence[Log],
    robot: Machine,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
    declared: Sequence[Effect] = (),
    learnt: Learnt | None = None,
    settings: TraceSettings = DEFAULT,
) -> Trace:
    """`trace` without the files.

    Args:
        logs: of one robot.
        robot: or fixed machine, as declared.
        seed: of the noise floor and the bootstraps.
        progress: called with the share done.
        declared: effects already in the model.
        learnt: observers and bounds for the filters, or None.
        settings: of the trace.
    """
    report = progress or (lambda share: None)
    found = diagnose(logs, robot, seed, lambda share: report(0.88 * share), declared, settings)
    stretches: tuple[BeforeAfter, ...] = ()
    if found.attribution is not None:
        cases = cases_of(logs, robot, declared, settings)
        stretches = _filtered(cases, found.effects, learnt or Learnt())
    filters = {}
    for name in dict.fromkeys(s.filter for s in stretches):
        pairs = [s.metrics for s in stretches if s.filter == name]
        before, after = (mean_metrics([pair[i] for pair in pairs]) for i in (0, 1))
        filters[name] = {"before": before, "after": after}
    harm = tuple(
        f"{name} filter: farther off with what was found"
        for name, m in filters.items()
        if m["after"]["ape_trans"] > settings.harm * m["before"]["ape_trans"]
    )
    motion = motion_to_distinguish([r["name"] for r in found.rivals]) if found.rivals else ""
    report(1.0)
    known = vars(replace(found, notes=found.notes + harm))
    return Trace(**known, filters=filters, stretches=stretches, motion=motion)


def _filtered(
    cases: Sequence[LogUnderModel], effects: Sequence[Effect], learnt: Learnt
) -> tuple[BeforeAfter, ...]:
    done: list[BeforeAfter] = []
    for case in cases:
        if case.fixed or not isinstance(case.robot, Robot) or not case.log.has("imu"):
            continue
        t = case.log.t
        begin = t[0] + (1 - case.settings.report_share) * (t[-1] - t[0])
        done += before_and_after(case.log, case.robot, effects, learnt, begin, t[-1])
    return tuple(done)
