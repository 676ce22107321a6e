"""Trace measured logs: from their residual to the missing effect, and the errors before and
after.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any

from surefoot.models.attribution.data import dead_contacts
from surefoot.models.attribution.diagnose import DiagnosisOptions, diagnose, logs_under_model
from surefoot.models.attribution.model_error import ModelError, model_error_from_dict
from surefoot.scenarios.cache import contents_digest
from surefoot.scenarios.estimate.contact_sources import contact_lines
from surefoot.scenarios.estimate.inputs import not_plausible
from surefoot.scenarios.estimate.run import Learnt
from surefoot.scenarios.settings import TraceSettings
from surefoot.scenarios.stages import percent_bar
from surefoot.scenarios.trace import filters
from surefoot.scenarios.trace.long_logs import in_blocks, note_on_blocks, read_in_blocks
from surefoot.scenarios.trace.next_steps import next_steps
from surefoot.scenarios.trace.report import write_outputs
from surefoot.scenarios.trace.result import Trace
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import protect, refuse_overwrite, whole_folder
from surefoot.sim.common.limits import bounded_json
from surefoot.sim.effects import Effect
from surefoot.sim.effects.file import load_effects
from surefoot.sim.log import Log
from surefoot.sim.robot.catalog import of_robot
from surefoot.sim.robot.machine import Machine, machine_for_log

OUTPUTS = ("trace.json", "effects.toml", "report.html", "trace.rrd")
_REPORT_SHARE = 0.35
"""Share of each log, at its end, that filters run over."""


@dataclass(frozen=True)
class TraceOptions(DiagnosisOptions):
    """What a trace is given besides the logs and the model of the robot.

    Attributes:
        learnt: observers and bounds for the filters that need them.
        warnings: about the logs, such as implausible values, which come first among the notes.
        contacts: better contacts for the logs; noted unless contacts are as punctual as the
            model's with the effects found, which other contacts may only stand in for.
        files: of logs and results, for the commands that the report says to run next.
    """

    learnt: Learnt = field(default_factory=Learnt)
    warnings: tuple[str, ...] = ()
    contacts: tuple[str, ...] = ()
    files: TraceSettings | None = None


def trace_files(settings: TraceSettings) -> Trace:
    """Trace the logs of some files, with what is implausible in them, or would be better, noted.

    Raises SurefootError saying what is missing or wrong, also where the logs are of several robots.
    """
    fitted = [read_in_blocks(path) for path in settings.logs]
    held_out = [read_in_blocks(path) for path in settings.holdout]
    declared = None if settings.declared is None else load_effects(settings.declared)
    first = [blocks[0] for blocks in (*fitted, *held_out)]
    robots = sorted({log.meta.robot for log in first if log.meta.robot})
    if not settings.robot and len(robots) > 1:
        raise SurefootError(f"the logs are of {' and '.join(robots)}: trace one robot at a time")
    robot, *_ = [machine_for_log(log, settings.robot) for log in first]
    # The first block of a long log is checked, as `estimate` checks its first minutes.
    warnings = not_plausible(first, settings.robot, settings.strict)
    contacts: list[tuple[str, ...]] = []
    for log in first:
        with percent_bar("contacts") as progress:
            named = of_robot(log, settings.robot)
            said, changes = contact_lines(named, progress, only_better=True)
        lines = "`surefoot info LOG --contacts` prints the lines"
        contacts.append(("; ".join((*said, lines) if changes else said),) if said else ())
    since = unchanged_beside(settings.declared, declared or ()) if settings.declared else None
    if since is not None and held_out:
        raise SurefootError(
            f"--holdout: runs are compared with those of {settings.declared} one by one, so that "
            "nothing is fitted: trace the other by itself"
        )
    options = TraceOptions(
        seed=settings.seed,
        declared=declared,
        since=since,
        holdout=list(chain(*held_out)),
        warnings=(*_numbered(warnings), *note_on_blocks([*fitted, *held_out])),
        contacts=_numbered(contacts),
        files=settings,
    )
    with percent_bar("trace") as progress:
        return trace(list(chain(*fitted)), robot, settings.out, options, progress, settings.force)


def _numbered(lines: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Lines on each log, with its number: a trace must not depend on the names of its logs."""
    many = len(lines) > 1
    return tuple(
        f"log {k}: {line}" if many else line for k, of_log in enumerate(lines, 1) for line in of_log
    )


def trace(
    logs: Sequence[Log],
    robot: Machine,
    out: Path | str,
    options: TraceOptions = TraceOptions(),
    progress: Callable[[float], None] | None = None,
    force: bool = False,
) -> Trace:
    """Find which effect `robot` lacks as a model of the logs, and what adding it changes.

    A log of more than twenty minutes is traced on blocks of it (`scenarios.trace.long_logs`).

    Raises SurefootError where `out` has such files (without `force`) or a held-out log is also one
    to fit on.

    Args:
        logs: of one machine. Only time, IMU, joints, feet, reference and rate are read.
        robot: the declared model.
        out: folder for trace.json, effects.toml, report.html and trace.rrd.
        options: declared effects, held-out logs, seed and the like.
        progress: called with the share done, 0 to 1.
        force: overwrite these files.
    """
    out = Path(out)
    if not logs:
        raise SurefootError("trace: needs at least one log")
    seen = set()
    for log in logs:
        if (digest := contents_digest(log)) in seen:
            raise SurefootError(f"{log.name}: the same log is given twice")
        seen.add(digest)
    for log in options.holdout:
        if contents_digest(log) in seen:
            raise SurefootError(f"holdout {log.name}: is also a log to fit on")
    for name in OUTPUTS:
        refuse_overwrite(out / name, force)
    cut, cut_holdout = [in_blocks(log) for log in logs], [in_blocks(log) for log in options.holdout]
    unseen = replace(options, holdout=list(chain(*cut_holdout)))
    found = trace_logs(list(chain(*cut)), robot, unseen, progress)
    notes = (*note_on_blocks([*cut, *cut_holdout]), *found.notes)
    steps = next_steps(found, options.files, robot) if options.files else ()
    found = replace(found, notes=notes, steps=steps)
    with whole_folder(out, force) as folder:
        write_outputs(found, robot, folder)
    return found


def trace_logs(
    logs: Sequence[Log],
    robot: Machine,
    options: TraceOptions = TraceOptions(),
    progress: Callable[[float], None] | None = None,
) -> Trace:
    """`trace` without writing files. The robot may be a legged one, a machine on a fixed base, or
    one that is known by its feet alone.
    """
    report = progress or (lambda share: None)
    learnt = options.learnt
    judged = replace(options, harmful=filters.harmful_to_filters)
    found = diagnose(logs, robot, judged, lambda share: report(0.88 * share))
    cases = [run.case for run in found.runs]
    if found.attribution is not None and not cases:
        cases = logs_under_model(logs, robot, options.declared or ())
    stretches = filters.before_and_after(cases, found.effects, learnt, _REPORT_SHARE)
    held_out = [run.case for run in found.held_out.runs] if found.held_out else []
    unseen = filters.before_and_after(held_out, found.effects, learnt, 1.0)
    metrics, unseen_metrics = filters.mean_metrics(stretches), filters.mean_metrics(unseen)
    harm = tuple(
        f"{name} filter: larger error with the effects found"
        for name, sides in (unseen_metrics or metrics).items()
        if filters.change_of_errors(sides) == "worse"
    )
    report(1.0)
    dead = dict.fromkeys(note for log in logs if (note := dead_contacts(log)))
    timing = found.channels.get("contact_timing")
    punctual = timing is not None and timing.within_floor
    warnings = (*options.warnings, *(() if punctual else options.contacts))
    known = vars(replace(found, notes=(*warnings, *found.notes, *harm)))
    return Trace(
        **known,
        filters=metrics,
        stretches=stretches,
        unseen_filters=unseen_metrics,
        worse=(*(name for name, c in found.channels.items() if c.worse), *harm),
        causes=filters.causes_of_drift(held_out or cases, found.effects),
        warnings=(*warnings, *dead),
        limbs=robot.limbs,
    )


def unchanged_beside(effects_file: Path, declared: Sequence[Effect]) -> ModelError | None:
    """The model's error in unchanged runs, from the trace.json beside a file of effects, if that
    trace found these effects and had enough runs; else None.

    Raises SurefootError where the trace.json is damaged.
    """
    file = effects_file.with_name("trace.json")
    if not file.is_file():
        return None
    protect(file)
    said = bounded_json(file, "trace")
    known = isinstance(said, dict) and "unchanged" in said
    if not known or not _found(said.get("effects"), declared):
        return None
    try:
        return model_error_from_dict(said["unchanged"])
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError, IndexError):
        raise SurefootError(f"{file}: 'unchanged' is damaged; trace the runs again") from None


def _found(said: Any, declared: Sequence[Effect]) -> bool:
    """Whether a trace's effects are these, in any order: the file has them as they are compensated,
    the trace the strongest first.
    """
    if not isinstance(said, list) or not all(isinstance(one, dict) for one in said):
        return False
    found = [(one.get("name"), one.get("target"), one.get("value")) for one in said]
    return sorted(found, key=repr) == sorted(
        ((one.name, one.target, one.value) for one in declared), key=repr
    )
