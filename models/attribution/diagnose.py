"""Trace logs to the effects that a robot's model lacks: from logs to a verdict."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from surefoot.models.attribution.change import find_change
from surefoot.models.attribution.data import (
    data_notes,
    dead_contacts,
    readings,
    split_of,
    untraceable_reason,
)
from surefoot.models.attribution.effect_sizes import Found, is_sampling_lag
from surefoot.models.attribution.evidence import (
    Key,
    LogUnderModel,
    log_under_model,
    slowest_rate,
    with_compensated,
)
from surefoot.models.attribution.explain import (
    Candidate,
    Explanation,
    FittedRun,
    Problem,
    explain,
    problem_of,
    zeros_beside,
)
from surefoot.models.attribution.forces import (
    FootFriction,
    Push,
    estimate_friction,
    outside_forces,
    pushed_bins,
    slip_effect,
    slip_notes,
    slippery_places,
)
from surefoot.models.attribution.judgement import (
    ChannelLevel,
    Findings,
    HeldOutRuns,
    Residuals,
    Unseen,
    find_harmful_effect,
    residuals_with,
    verdict_of,
)
from surefoot.models.attribution.metric import Metric
from surefoot.models.attribution.model_error import (
    MEAN_WINDOW,
    ModelError,
    model_error,
    model_error_as_dict,
    run_sums,
)
from surefoot.models.attribution.noise_floor import (
    FloorWalk,
    NoiseFloor,
    left_deviations,
    noise_floor,
    noise_floor_with,
    settled_bins,
)
from surefoot.models.attribution.unexplained import Unexplained, curved_angles, sparse_regression
from surefoot.models.attribution.way_lost import way_lost
from surefoot.models.attribution.weights import FAR_ABOVE
from surefoot.models.residuals.binning import BIN, inner_bins
from surefoot.sim.common.errors import check_seed
from surefoot.sim.common.files import plain_json
from surefoot.sim.effects import Effect, in_order
from surefoot.sim.log import Log
from surefoot.sim.robot.machine import Machine

ONLY_BETWEEN_FEET = (
    "shows only as relative motion of feet in stance, as do effects that need a reference to be "
    "identified: log a reference"
)


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """Result of a trace.

    Attributes:
        verdict: attributed, confounded, none_of_these, not_identifiable, no_residual or unchanged.
        reasons: why the verdict is not better.
        attribution: the search; None where there was none.
        found: effects common to all logs, strongest first.
        runs: per-log effects, such as encoder zeros and the reference's clock.
        channels: residual of each channel on data that no fit has seen.
        averaged_over: time over which each residual is averaged [s].
        held_out: the same on held-out logs.
        masked_share: share of the stance that was masked as slipping.
        friction: of the feet; None where the logs lack the columns for it.
        floor: source of the noise floor.
        rivals: other effects that explain the data as well.
        notes: for the reader.
        unexplained: form of the remaining residual.
        model_error: how the model errs in these runs with `found` compensated, against which later
            runs are judged.
        least: for each effect, the least change that would have been named; where runs are compared
            with those that their model was calibrated on.
    """

    verdict: str
    reasons: tuple[str, ...] = ()
    attribution: Explanation | None = None
    found: tuple[Found, ...] = ()
    runs: tuple[FittedRun, ...] = ()
    channels: dict[str, ChannelLevel]
    held_out: HeldOutRuns | None = None
    masked_share: float = 0.0
    friction: FootFriction | None = None
    floor: str = "none"
    rivals: tuple[dict[str, Any], ...] = ()
    notes: tuple[str, ...] = ()
    unexplained: tuple[Unexplained, ...] = ()
    model_error: ModelError | None = None
    least: dict[Key, float] = field(default_factory=dict)
    averaged_over: float = BIN

    @property
    def rejected(self) -> tuple[tuple[Effect, str], ...]:
        """Effects that were considered and are not found, and why last."""
        if self.attribution is None:
            return ()
        every = (*self.attribution.dropped, *self.attribution.rejected)
        return tuple({(one.name, one.target): (one, why) for one, why in every}.values())

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The effects found, in the order in which they are compensated."""
        return in_order([one.effect for one in self.found])

    def as_dict(self) -> dict[str, Any]:
        """The result as plain JSON types, independent of the logs' names and metadata."""
        rounds = self.attribution.rounds if self.attribution else ()
        out: dict[str, Any] = {
            "verdict": self.verdict,
            "reasons": list(self.reasons),
            "effects": [_with_interval(one) for one in self.found],
            "runs": [_run_as_dict(run) for run in self.runs],
            "channels": _levels(self.channels),
            "averaged_over": self.averaged_over,
            "masked_share": self.masked_share,
            "friction": asdict(self.friction) if self.friction else None,
            "floor": self.floor,
            "notes": list(self.notes),
            "candidates": [[_candidate(c) for c in candidates] for candidates in rounds],
        }
        if self.held_out:
            out["holdout"] = {
                "channels": _levels(self.held_out.channels),
                "runs": [_run_as_dict(run) for run in self.held_out.runs],
            }
        if self.verdict == "none_of_these":
            out["remainder"] = [asdict(form) for form in self.unexplained]
        if self.model_error:
            out["unchanged"] = model_error_as_dict(self.model_error)
        if self.least:
            out["least"] = [
                {"name": name, "target": target, "value": value}
                for (name, target), value in self.least.items()
            ]
        if self.rivals:
            out["rivals"] = list(self.rivals)
        if self.rejected:
            out["rejected"] = [{**one.as_dict(), "because": why} for one, why in self.rejected]
        return plain_json(out)


@dataclass(frozen=True)
class DiagnosisOptions:
    """What a diagnosis is given besides the logs and the model of the robot.

    Attributes:
        seed: of the noise floor and the bootstraps.
        declared: effects that belong to the model and are compensated first. With any sequence,
            even an empty one, the diagnosis looks for what has *changed*: encoder zeros, biases and
            clocks are fitted to each log separately and are not effects. The same holds for several
            logs.
        since: error of the model in runs of the unchanged machine, from the trace that found
            `declared`. With it, the diagnosis says what changed since (`find_change`).
        holdout: logs of the same machine, on which the result is judged and nothing is fitted.
        harmful: of logs, effects and simulated walks of a robot with these, an effect that makes
            some use of the model worse, and why it harms; None if none does. Asked of the held-out
            logs where there are any.
    """

    seed: int = 0
    declared: Sequence[Effect] | None = None
    since: ModelError | None = None
    holdout: Sequence[Log] = ()
    harmful: Callable[
        [Sequence[LogUnderModel], Sequence[Effect], Sequence[FloorWalk]],
        tuple[Effect, str] | None,
    ] = lambda cases, effects, walks: None


DEFAULT_OPTIONS = DiagnosisOptions()


def diagnose(
    logs: Sequence[Log],
    robot: Machine,
    options: DiagnosisOptions = DEFAULT_OPTIONS,
    progress: Callable[[float], None] = lambda share: None,
) -> Diagnosis:
    """Find which effects `robot` lacks as a model of the logs.

    Args:
        logs: of one machine. Only time, IMU, joints, feet, reference and rate are read.
        robot: the declared model.
        options: declared effects, held-out logs, seed and the like.
        progress: called with the share that is done.

    Without a reference, a walk is traced by the relative motion of feet in simultaneous stance and
    by the joints alone; the notes name what only a reference would show.
    """
    seed, declared = options.seed, options.declared
    since = options.since
    check_seed(seed)
    # The logs under the declared model. Zeros and clocks of several logs belong to each log.
    model = declared or ()
    several = len(logs) > 1 or declared is not None
    cases = logs_under_model(logs, robot, model)
    split = split_of(cases)
    cannot = untraceable_reason(cases, split, new=since is not None)
    if cannot:
        reasons = (cannot,)
        return Diagnosis(verdict="not_identifiable", reasons=reasons, channels={}, notes=reasons)
    progress(0.02)
    if since is not None:
        return _changed(cases, since)
    # The noise floor, then the search for effects: once, or twice where the effects that were found
    # tell whether feet slide.
    friction = estimate_friction(cases, np.random.default_rng(seed))
    slip = slip_effect(friction)
    unseen = logs_under_model(options.holdout, robot, model)
    problem = problem_of(cases, split.fit, several)

    def explained(slip: Sequence[Found]) -> tuple[Explanation, _Floors]:
        """The search, and the floors that it was based on."""
        floors = _Floors(cases, [one.effect for one in slip], slippery_places(friction))
        progress(0.4)

        def harmful(metric: Metric, now: Problem, effects: Sequence[Effect]):
            if not effects:
                return None
            floor = floors.of(effects)
            sides = residuals_with(now, effects, metric, floor, split.fit)
            parts = {"bins that no fit has seen": split.report}
            data = [Unseen(sides, split.report, parts)]
            if unseen:
                data.append(_held_out(unseen, effects, (), floor, several)[1])
            return find_harmful_effect(data) or options.harmful(
                unseen or now.cases, effects, floor.walks
            )

        def needed(
            metric: Metric, now: Problem, effects: Sequence[Effect], others: Sequence[Effect]
        ) -> bool:
            sides = residuals_with(now, others, metric, floors.of(others), split.fit)
            return bool(replace(sides, before=sides.left_by(effects)).worse(split.report))

        found = explain(
            problem,
            floors.plain.error,
            lambda effects, keys: left_deviations(floors.plain, floors.of(effects), keys),
            harmful,
            needed,
            lambda x: progress(0.4 + 0.5 * x),
        )
        floors.of([one.effect for one in found.found])
        return found, floors

    result, floors = explained(slip)
    if result.found and friction:
        model_with = [*model, *(one.effect for one in result.found)]
        with_found = logs_under_model(logs, robot, model_with)
        friction = estimate_friction(with_found, np.random.default_rng(seed))
        slides = slip_effect(friction)
        if bool(slides) != bool(slip):
            result, floors = explained(slides)
        slip = slides
    lags = _sampling_lags(result.found, cases)
    way = way_lost([run.case for run in result.runs], unseen)
    found = (*(f for f in result.found if f not in lags), *slip, *way.found)
    effects = in_order([one.effect for one in found])
    runs = _with_lags(result.runs, lags)
    # Residuals before and after, and where outside forces act, which is left out of the verdict.
    problem = replace(problem, cases=[run.case for run in runs])
    sides = residuals_with(problem, effects, result.metric, floors.last, split.fit)
    averaged_over = MEAN_WINDOW if problem.by_windows else BIN
    pushes = outside_forces(problem.cases, sides.after, sides.evidence, averaged_over)
    pushed = pushed_bins(problem.cases, sides.evidence, pushes)
    pushed_away = [f for f in found if pushes and not _still_explains(f.effect, sides, ~pushed)]
    found = tuple(f for f in found if f not in pushed_away)
    # The verdict, on the part that no fit has seen and on held-out logs.
    channels = sides.levels(split.report & ~pushed)
    held_out = None
    if unseen:
        fitted, data = _held_out(unseen, effects, lags, floors.last, several)
        held_out = HeldOutRuns(data.sides.levels(data.used), fitted)
    progress(0.95)
    curves = curved_angles(result, problem.cases)
    verdict, reasons = verdict_of(
        Findings(
            found=found,
            channels=channels,
            imitated=result.imitated,
            curves=bool(curves),
            rivals=result.rivals,
            pushes=pushes,
            pushed_away=pushed_away,
            limbs=cases[0].robot.limbs,
        )
    )
    if verdict == "attributed" and not all(case.motion.by_reference for case in cases):
        shown = _shown_between_feet(found)
        verdict, reasons = ("confounded", shown) if shown else (verdict, reasons)
    # The form of what no effect explains.
    unexplained: tuple[Unexplained, ...] = ()
    if verdict == "none_of_these":
        above = [name for name, c in channels.items() if not c.at_floor or c.worse]
        above.sort(key=lambda name: -channels[name].after / channels[name].highest)
        unexplained = curves + sparse_regression(
            problem.cases, sides.after, sides.weights, above, split.fit, split.report
        )
    if declared is not None and verdict == "not_identifiable":
        # Without a significant effect, no change is reported; the reasons say so.
        found = ()
    dead = dict.fromkeys(note for log in logs if (note := dead_contacts(log)))
    progress(1.0)
    return Diagnosis(
        verdict=verdict,
        reasons=reasons,
        attribution=result,
        found=found,
        runs=runs if several or lags else (),
        channels=channels,
        held_out=held_out,
        masked_share=sides.weights.share,
        friction=friction,
        floor=floors.last.source,
        rivals=tuple(
            {"name": name, "target": target, "overlap": shared}
            for (name, target), shared in result.rivals
        ),
        notes=(
            *dead,
            *data_notes(cases, floors.plain),
            *slip_notes(friction, "leg_velocity" in channels),
            *_push_notes(pushes, reasons),
            *_result_notes(found, channels),
            *_lag_notes(lags),
            *way.notes,
        ),
        unexplained=unexplained,
        model_error=_error_of(cases, effects) if several else None,
        averaged_over=averaged_over,
    )


class _Floors:
    """Noise floors of the declared model with effects that it has and compensates."""

    def __init__(
        self, cases: Sequence[LogUnderModel], ground: Sequence[Effect], slippery: float | None
    ):
        self.plain = self.last = noise_floor(cases, ground, slippery)

    def of(self, effects: Sequence[Effect]) -> NoiseFloor:
        """The floor with these effects; that of nearly the same sizes is kept."""
        self.last = noise_floor_with(self.plain, effects, self.last)
        return self.last


def _held_out(
    cases: Sequence[LogUnderModel],
    effects: Sequence[Effect],
    lags: Sequence[Found],
    floor: NoiseFloor,
    several: bool,
) -> tuple[tuple[FittedRun, ...], Unseen]:
    """Held-out logs, to which only each log's own zeros and biases are fitted.

    Args:
        cases: the logs.
        effects: found.
        lags: of the rows, which are compensated as well.
        floor: noise floor of the model with the effects.
        several: whether zeros, biases and clocks belong to each log.
    """
    inner = np.concatenate([inner_bins(case.motion.t) for case in cases])
    of_floor = settled_bins if floor.walks else inner_bins
    judged = np.concatenate([of_floor(case.motion.t) for case in cases])
    problem = problem_of(cases, inner, several)
    fitted, metric = zeros_beside(problem, floor.error, effects)
    runs = _with_lags(fitted, lags)
    problem = replace(problem, cases=[run.case for run in runs])
    sides = residuals_with(problem, effects, metric, floor, inner)
    log = sides.evidence.log
    parts = {f"held-out run {n + 1}": inner & (log == n) for n in range(len(cases))}
    return runs, Unseen(sides, judged, parts)


def _with_lags(runs: Sequence[FittedRun], lags: Sequence[Found]) -> tuple[FittedRun, ...]:
    """Each log with these lags compensated as well."""
    if not lags:
        return tuple(runs)
    effects = tuple(one.effect for one in lags)
    return tuple(
        FittedRun(
            with_compensated(run.case, effects),
            (*run.zeros, *lags),
            (*run.compensated, *effects),
        )
        for run in runs
    )


def _sampling_lags(found: Sequence[Found], cases: Sequence[LogUnderModel]) -> list[Found]:
    """Lags within a row of the logs (`is_sampling_lag`), which are no effects of the machine."""
    rate = slowest_rate(cases)
    return [one for one in found if is_sampling_lag(one.effect, rate)]


def _push_notes(pushes: Sequence[Push], reasons: Sequence[str]) -> list[str]:
    """What the reasons do not say of outside forces."""
    said = [one.in_words() for one in pushes]
    return [f"excluded from the verdict: {words}" for words in said if words not in reasons]


def _lag_notes(lags: Sequence[Found]) -> list[str]:
    return [
        f"{one.effect.name} of {1e3 * one.effect.value:+.2g} ms is compensated and not counted as "
        "an effect: it is within a row, whose readings a log gives one time"
        for one in lags
    ]


def _shown_between_feet(found: Sequence[Found]) -> tuple[str, ...]:
    """A reason that names the effects seen only in the relative motion of the feet."""
    effects = [one.effect for one in found]
    by_feet = [e for e in effects if "leg_velocity" in e.traced_at(e.target).channels]
    names = ", ".join(f"{one.name} {one.target}" for one in by_feet)
    return (f"{names}: {ONLY_BETWEEN_FEET}",) if by_feet else ()


def _still_explains(one: Effect, sides: Residuals, used: np.ndarray) -> bool:
    """Whether an effect surely explains anything of the bins of a mask `used` (M,)."""
    return not type(one).is_compensated() or bool(
        sides.gained(sides.left_without(one), used)[1][0] > 0.0
    )


def logs_under_model(
    logs: Sequence[Log], robot: Machine, declared: Sequence[Effect]
) -> list[LogUnderModel]:
    """The logs' readings with the declared effects compensated, each with its model."""
    robot = _with_declared(robot, declared)
    read = [readings(log, robot.limbs.feet_alone) for log in logs]
    return [log_under_model(log, robot, declared) for log in read]


def _with_declared(robot: Machine, declared: Sequence[Effect]) -> Machine:
    """A fixed base that knows what was declared of it and it may have less of."""
    if not robot.fixed:
        return robot
    sizes: dict[tuple[str, str], float] = {}
    for one in declared:
        if one.may_lessen:
            for part in one.members(robot.limbs):
                sizes[one.name, part] = sizes.get((one.name, part), 0.0) + one.value
    return replace(robot, extras=replace(robot.extras, declared=tuple(sizes.items())))


def _result_notes(found: Sequence[Found], channels: dict[str, ChannelLevel]) -> list[str]:
    notes = [f"{name}: worse with the effects found" for name, c in channels.items() if c.worse]
    notes += [
        f"{name}: {c.after / c.highest:.0f} times its residual in simulation is left, which may "
        "distort the sizes"
        for name, c in channels.items()
        if found and c.after > FAR_ABOVE * c.highest
    ]
    return notes


def _changed(cases: Sequence[LogUnderModel], since: ModelError) -> Diagnosis:
    """What changed since the runs that the model's error is of."""
    change = find_change(cases, since)
    return Diagnosis(
        verdict=change.verdict,
        reasons=change.reasons,
        found=change.found,
        runs=tuple(FittedRun(c, zeros, ()) for c, zeros in zip(cases, change.zeros, strict=True)),
        channels=change.channels,
        averaged_over=MEAN_WINDOW if cases[0].fixed else BIN,
        floor=f"what no effect explains of {since.runs} runs of the unchanged machine",
        rivals=tuple(
            {"name": name, "target": target, "overlap": one.overlap}
            for one in change.rivals
            for name, target in one.keys[:1]
        ),
        notes=tuple(_push_notes(change.pushes, change.reasons)),
        least=change.least,
    )


def _error_of(cases: Sequence[LogUnderModel], effects: Sequence[Effect]) -> ModelError | None:
    """Error of the model with these effects, as the runs show it. A run's own zeros are not
    compensated, since those of new runs are not either.
    """
    runs = [run_sums(case, effects) for case in cases]
    return model_error(runs, cases[0].robot.limbs)


def _with_interval(one: Found) -> dict[str, Any]:
    criteria = {"excess": one.excess, "agreement": one.agreement}
    return {**one.effect.as_dict(), "interval": list(one.interval)} | (
        criteria if np.isfinite(one.excess) else {}
    )


def _run_as_dict(run: FittedRun) -> list[dict[str, Any]]:
    """A run's own effects, and which of them were compensated."""
    return [
        {**_with_interval(one), "compensated": one.effect in run.compensated} for one in run.zeros
    ]


def _levels(channels: dict[str, ChannelLevel]) -> dict[str, dict[str, Any]]:
    levels = ("before", "after", "noise_floor", "highest", "unit")
    return {name: {level: getattr(c, level) for level in levels} for name, c in channels.items()}


def _candidate(c: Candidate) -> dict[str, Any]:
    name, target = c.key
    return {
        "name": name,
        "target": target,
        "value": c.size,
        "floor": c.least,
        "gain": c.share,
        "earned": c.earned,
    }
