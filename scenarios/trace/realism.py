"""Realism of simulated walks: a measured log compared with simulated walks in the same style.

The drift of the leg filter only evaluates a simulated robot. Its effects and gait are chosen by
`trace` and the realism card, never by this comparison.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import ttest_1samp

from surefoot.models.attribution.sensor_noise import reference_sampling, resample_reference
from surefoot.models.realism.card import CARD_DIMENSIONS, Card, realism_card
from surefoot.models.realism.quantities import period
from surefoot.models.realism.walk_view import WalkView
from surefoot.scenarios.datasets.as_walked import AsWalked, load_as_walked
from surefoot.scenarios.datasets.kept_walks import DrawnWalk, KeptLogs, Report, kept_walks
from surefoot.scenarios.estimate.run import run_filter
from surefoot.scenarios.reporting.html import Section
from surefoot.scenarios.reporting.pages import origin_of, write_page, write_results
from surefoot.scenarios.settings import RealismSettings
from surefoot.scenarios.trace.realism_figures import pictures
from surefoot.sim.common.errors import SurefootError, check_seed
from surefoot.sim.common.files import refuse_overwrite, whole_folder, write_whole
from surefoot.sim.effects import Effect, effect
from surefoot.sim.effects.carry import carried, growth, scale_of
from surefoot.sim.log import Log
from surefoot.sim.physics.scene import TIMESTEP
from surefoot.sim.robot import Robot
from surefoot.sim.walking.imitation import replica, slower, style_of, walking_style

WALKS_EACH = 3
"""Simulated walks in a comparison, each with a seed of its own."""
REALISM_PACES = (1.0, 0.9, 0.8, 0.7)
"""Factors on the measured velocities, tried in turn until no simulated robot falls."""
REALISM_FILES = ("realism.json", "realism.csv", "drift.csv", "table.md", "report.html")
METHOD = (
    "Simulated walks have the gait, speeds, columns, rate and reference of the measured one. A "
    "quantity is like the measured one if the whole 95 % interval of the difference, by bootstrap "
    "over strides, is within its tolerance, unlike if none of it is, and undecided otherwise. "
    "Tolerances were set before any walk. Drift is the RPE over 1 m [m/m], with a model that does "
    "not include the effects of the simulated robot; the interval of its ratio is over the seeds "
    "of the simulated walks."
)
FILTER = "leg"
WITHIN = 0.15
"""Largest difference of the simulated from the measured drift, as a share of it; set beforehand."""


@dataclass(frozen=True)
class SimulatedRobot:
    """A robot to simulate, beside a measured log.

    Attributes:
        words: its name in the report, such as "as drawn".
        effects: of the robot, by default those of `walked`.
        walked: gait, sensors and effects measured on a robot's walk; by default the plain ones.
        walker: another robot than the log's; measured values are scaled to it
            (`sim.effects.carry`).
    """

    words: str
    effects: Sequence[Effect] = ()
    walked: AsWalked | None = None
    walker: Robot | None = None


@dataclass(frozen=True)
class WalkComparison:
    """A measured walk, simulated walks in its style, and the realism card that compares them.

    Attributes:
        words: name of the simulated robot, such as "as drawn".
        measured: the measured walk.
        simulated: the simulated walks.
        card: the comparison.
        pace: speed of the simulated walks relative to the measured one.
    """

    words: str
    measured: WalkView
    simulated: tuple[WalkView, ...]
    card: Card
    pace: float


def realism(
    log: Log,
    robot: Robot,
    settings: RealismSettings,
    effects: Sequence[Effect] = (),
    walker: Robot | None = None,
    progress: Report = lambda share: None,
) -> str:
    """Compare and write realism.json, realism.csv, drift.csv, table.md and report.html into `out`;
    returns the text of table.md.

    Compares walks of the robot as drawn and, with effects or `as_walked`, of the robot with these.
    Raises SurefootError where the log lacks a column or has too few strides, where the simulated
    robot falls at every pace, and where a file exists and `force` is not given.

    Args:
        log: the measured log, with IMU, joint angles, contacts and reference.
        robot: as declared.
        settings: where to, and the seed.
        effects: of the simulated robot, by default those measured on a walk.
        walker: another robot to simulate (see `SimulatedRobot`).
        progress: called with the share done, 0 to 1.
    """
    out, seed, force = settings.out, settings.seed, settings.force
    check_seed(seed)
    for name in REALISM_FILES:
        refuse_overwrite(out / name, force)
    compared = [SimulatedRobot("as drawn", walker=walker)]
    if effects or settings.as_walked:
        walked = load_as_walked() if settings.as_walked else None
        compared.append(SimulatedRobot("as walked", effects, walked, walker))
    parts = len(compared)
    found = [
        compare_walks(log, robot, one, seed, lambda done, k=k: progress((k + done) / parts))
        for k, one in enumerate(compared)
    ]
    drifts = [drift_row(one) for one in found]
    rows = [{"walk": c.words, **asdict(r)} for c in found for r in c.card.rows]
    walker_name = found[0].simulated[0].robot.name
    title = f"Realism: {log.name} beside simulated walks of {walker_name}"
    cards = [Section(f"Realism card: {one.words}", "", card_table(one.card)) for one in found]
    shown = realism_sections(found, drifts)
    with whole_folder(out, force) as folder:
        tables = {"realism": rows, "drift": drifts}
        text = write_results(folder, title, [*shown, *cards], tables)
        values = json.dumps(_json(found) | {"drift": drifts}, indent=2)
        write_whole(folder / "realism.json", values + "\n")
    if settings.page:
        filed = [
            Section("Realism card", "Every quantity.", rows, file="realism"),
            Section("Drift", f"The `{FILTER}` filter on each walk.", drifts, file="drift"),
        ]
        write_page(settings.page, title, [*shown, *filed], origin_of(__name__, "surefoot realism"))
    return text


def compare_walks(
    log: Log,
    robot: Robot,
    simulating: SimulatedRobot,
    seed: int = 0,
    progress: Report = lambda share: None,
) -> WalkComparison:
    """Compare a measured log with walks of one simulated robot.

    Args:
        log: the measured log.
        robot: as declared.
        simulating: the robot to simulate.
        seed: of the walks and of the intervals.
        progress: called with the share done, 0 to 1.
    """
    effects, walked, walker = simulating.effects, simulating.walked, simulating.walker
    measured = WalkView(log, robot)
    style = walking_style(log, robot)
    simulated, declared = simulated_robot(robot), robot
    scales = None
    if walker:
        stride = float(np.median(period(measured)[0]))
        scales = scale_of(robot, stride), scale_of(walker)
        speed, turn = (growth(CARD_DIMENSIONS[unit], *scales) for unit in ("m/s", "rad/s"))
        style = style_of(style, walker, speed, turn)
        effects = carried(effects, *scales)
        # Evaluate its walks with point feet if the measured robot's model has them.
        has_radius = robot.foot_radius.max() > 0.0
        simulated, declared = walker, replace(walker, foot_radius=walker.foot_radius * has_radius)
    scenario, poised = replica(style, simulated, "replica")
    rate = min(log.rate, 1.0 / TIMESTEP)
    scenario = replace(scenario, sensors=replace(scenario.sensors, rate=rate))
    added = beyond_simulated(effects, declared, simulated)
    if walked:
        scenario = walked.scenario(scenario)
        added = added or walked.effects_on(simulated)
    # Undeclared, since the walks are evaluated with the declared model, like the measured log.
    logs, pace = _walks(DrawnWalk(scenario, poised, seed, added), progress)
    walks = tuple(
        WalkView(seen_as(replace(one, name=f"{simulating.words} {k}"), log, [seed, k]), declared)
        for k, one in enumerate(logs)
    )
    card = realism_card(measured, walks, np.random.default_rng(seed), scales)
    return WalkComparison(simulating.words, measured, walks, card, pace)


def seen_as(log: Log, measured: Log, seed: Sequence[int]) -> Log:
    """A simulated log with only the optional columns of a measured log, and an equally coarse
    reference.
    """
    groups = {"dq": "dq_", "tau": "tau_", "ref_v": "ref_v_", "force": "force_"}
    lacking = tuple(prefix for group, prefix in groups.items() if not measured.has(group))
    kept = [c for c in log.frame if not str(c).startswith(lacking)]
    reduced = replace(log, frame=log.frame[kept])
    sampling = reference_sampling(measured)
    if not sampling:
        return reduced
    return resample_reference(reduced, sampling, np.random.default_rng(seed))


def _walks(first: DrawnWalk, progress: Report) -> tuple[KeptLogs, float]:
    """WALKS_EACH walks at the fastest of REALISM_PACES at which none falls, and that pace.

    Args:
        first: of the walks, at the measured speeds; the seeds of the others count up from its own.
        progress: called with the share of the walks done at a pace.
    """
    for pace in REALISM_PACES:
        paced = replace(first, scenario=slower(first.scenario, pace))
        draws = [replace(paced, seed=first.seed + k) for k in range(WALKS_EACH)]
        logs = kept_walks(lambda k, _, draws=draws: draws[k], WALKS_EACH, 1, "replica", progress)
        if len(logs) == WALKS_EACH:
            return logs, pace
    raise SurefootError(
        f"realism: {first.robot.name} falls in simulation with the stride and posture of the log, "
        f"even at {100 * REALISM_PACES[-1]:.0f} % of its speed"
    )


def realism_sections(
    found: Sequence[WalkComparison], drifts: Sequence[Mapping[str, Any]]
) -> list[Section]:
    """The sections that report and page share: findings with the drifts, figures, and method."""
    shown = [{k: v for k, v in row.items() if k != "each walk"} for row in drifts]
    drawn = pictures(found[0].measured, {one.words: one.simulated for one in found})
    return [
        Section("Findings", findings(found, drifts), shown),
        Section("The walks compared", pictures=tuple(drawn)),
        Section("Method", _method(found)),
    ]


def findings(found: Sequence[WalkComparison], drifts: Sequence[Mapping[str, Any]]) -> str:
    """Sentences: how many quantities are alike, how the drifts compare, and which are unlike."""
    of = found[0]
    counts = [(c.card.counts["like"], c.card.counts["unlike"], c.words) for c in found]
    main = (
        f"Of {len(of.card.rows)} quantities, simulated walks of {of.simulated[0].robot.name} are "
        f"like {of.measured.log.name} in "
        f"{', '.join(f'{like} and unlike in {unlike} ({w})' for like, unlike, w in counts)}."
    )
    ratios = [f"{row['ratio']:.2f} ({row['simulated robot']})" for row in drifts]
    rest = [
        f"The `{FILTER}` filter drifts by {drifts[0]['measured']:.3f} m/m on the measured "
        f"walk; on simulated walks, by {', '.join(ratios)} times as much."
    ]
    for one in found:
        unlike = [row for row in one.card.rows if row.verdict == "unlike"]
        unlike.sort(key=lambda row: -abs(row.difference) / row.tolerance)
        worst = "; ".join(
            f"{r.quantity} ({r.simulated:.3g}, {r.measured:.3g} {r.unit})" for r in unlike[:3]
        )
        if unlike:
            rest.append(f"Most unlike {one.words} (simulated, measured): {worst}.")
    return f"{main}\n\n{' '.join(rest)}"


def _method(found: Sequence[WalkComparison]) -> str:
    one = found[0]
    paces = ", ".join(f"{100 * c.pace:.0f} % ({c.words})" for c in found)
    words = (
        f"{len(one.measured.clock)} measured strides, and {len(one.simulated)} simulated walks of "
        f"each robot at {paces} of the measured velocities. {METHOD}"
    )
    if one.simulated[0].robot.name != one.measured.robot.name:
        words += (
            "\n\nThe simulated robot is not the measured one. Measured values, tolerances and "
            "velocities are scaled to it by leg length and stride period."
        )
    missing = "; ".join(f"{name} ({why})" for name, why in one.card.missing.items())
    return words + (f"\n\nMissing: {missing}." if missing else "")


def card_table(card: Card) -> list[dict[str, str | float]]:
    """The card as table rows: values with their 95 % intervals, tolerance and verdict as text."""
    return [
        {
            "quantity": r.quantity,
            "unit": r.unit,
            "measured": f"{r.measured:.3g} ({r.measured_low:.3g} to {r.measured_high:.3g})",
            "simulated": f"{r.simulated:.3g} ({r.simulated_low:.3g} to {r.simulated_high:.3g})",
            "difference": f"{r.difference:.3g} ({r.difference_low:.3g} to {r.difference_high:.3g})",
            "tolerance": f"{r.tolerance:.3g}",
            "": r.verdict,
        }
        for r in card.rows
    ]


def _json(found: Sequence[WalkComparison]) -> dict:
    return {
        one.words: {
            "pace": one.pace,
            "counts": one.card.counts,
            "rows": [asdict(row) for row in one.card.rows],
            "missing": one.card.missing,
        }
        for one in found
    }


def simulated_robot(robot: Robot) -> Robot:
    """The robot for simulation: body and feet of its file, IMU mounted as declared."""
    return replace(Robot.load(robot.file), name=robot.name, p_BI=robot.p_BI, R_BI=robot.R_BI)


def beyond_simulated(
    effects: Sequence[Effect], robot: Robot, simulated: Robot
) -> tuple[Effect, ...]:
    """Effects found with the declared `robot`, less what `simulated` already has.

    Only `foot_rolling` differs: a declared model may have point feet, so that the size found is the
    whole radius, while the simulated feet have that of their file.
    """
    difference = float(np.mean(robot.foot_radius - simulated.foot_radius))
    if abs(difference) < 1e-9:
        return tuple(effects)
    return tuple(
        effect(e.name, e.target, e.value + difference) if e.name == "foot_rolling" else e
        for e in effects
    )


def drift_row(one: WalkComparison) -> dict[str, Any]:
    """RPE of the leg filter over 1 m [m/m] on each walk, NaN where it diverged, with feet as in the
    measured log's model.
    """
    views = (one.measured, *one.simulated)
    runs = [run_filter(FILTER, view.log, view.robot).metrics for view in views]
    measured, *simulated = [run.rpe_trans if run else np.nan for run in runs]
    radii = dict.fromkeys(f"{1e3 * view.robot.foot_radius.mean():.0f}" for view in views)
    ratio, low, high = ratio_of_drifts(measured, simulated)
    return {
        "simulated robot": one.words,
        "radius of the feet [mm]": ", in simulation ".join(radii),
        "measured": measured,
        "simulated": float(np.mean(simulated)),
        "each walk": ", ".join(f"{x:.3f}" for x in simulated),
        "ratio": ratio,
        "over seeds, 95 %": f"{low:.2f} to {high:.2f}",
        f"within {100 * WITHIN:.0f} %": "yes" if abs(ratio - 1.0) <= WITHIN else "no",
    }


def ratio_of_drifts(measured: float, simulated: Sequence[float]) -> tuple[float, float, float]:
    """Mean drift of the simulated walks over the measured one, and its 95 % interval over the
    walks' seeds (Student's t); NaN for one walk.
    """
    interval = ttest_1samp(simulated, 0.0).confidence_interval()
    return float(np.mean(simulated)) / measured, interval.low / measured, interval.high / measured
