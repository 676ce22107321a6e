"""An import map: the TOML file that describes the files and columns of a recording.

`MapFile` is the whole file, `sim.importing.sections` has its sections; the reference page of maps
documents them. An unknown key is an error, since a misspelt sign that is ignored costs days.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from surefoot.sim.common.errors import SurefootError, errors_in
from surefoot.sim.common.toml import read_typed
from surefoot.sim.importing.columns import EULER, Entries, MapColumn, read_column, read_columns
from surefoot.sim.importing.map_catalog import map_file
from surefoot.sim.importing.sections import (
    ContactTable,
    EvenTable,
    GroundTable,
    MotorLaw,
    ReferenceTable,
    RobotTable,
    Source,
)
from surefoot.sim.log.schema import GROUPS, leg_names


@dataclass(frozen=True)
class ImportMap:
    """A validated map.

    Attributes:
        path: of the map.
        sections: as they are written in the map.
        columns: of the log.
        clocks: time columns of the further files.
        reference_columns: columns of the reference.
        robot: name or file.
        model: entries of `Meta.model`.
    """

    path: Path
    sections: "MapFile"
    columns: dict[str, MapColumn]
    clocks: dict[str, MapColumn]
    reference_columns: dict[str, MapColumn]
    robot: str | None
    model: dict[str, Any]

    @classmethod
    def read(cls, path: str | Path) -> "ImportMap":
        """Read the map at `path`, or the bundled one of that name.

        Raises SurefootError naming file, section and key.
        """
        path = map_file(path)
        file = read_typed(path, MapFile)
        with errors_in(str(path)):
            return file.checked(path)


@dataclass(frozen=True)
class MapFile:
    """Contents of a map file."""

    columns: Entries
    """[columns] <column of the log> = "their column", or a table of it. The file of t is the main
    one, and its times are the log's rows.
    """
    source: Source = field(default_factory=Source)
    """[source]: the main file, which may instead be given on the command line."""
    sources: dict[str, Source] = field(default_factory=dict)
    """[sources.<name>]: further files."""
    reference: ReferenceTable | None = None
    """[reference]: the motion that the log is compared with."""
    robot: RobotTable | None = None
    """[robot]: the robot or machine of the log."""
    ground: GroundTable = field(default_factory=GroundTable)
    """[ground]: where it walks."""
    contact: ContactTable | None = None
    """[contact]: detection of contacts."""
    motor_law: MotorLaw | None = None
    """[motor_law]: control law of the motors."""
    even: EvenTable | None = None
    """[even]: resampling and interpolation."""

    def checked(self, path: Path) -> ImportMap:
        """Check the sections against each other and return the map. Raises SurefootError."""
        names = tuple(self.sources)
        columns = read_columns("columns", self.columns, names)
        if ("t" in columns) == (self.source.rate is not None):
            raise SurefootError("[columns] t or [source] rate must be given, and not both")
        if "t" in columns and columns["t"].source:
            raise SurefootError("[columns] t must be of the main file, whose clock is the log's")
        if any(name in columns for name in EULER):
            raise SurefootError("[columns] an attitude as angles goes to [reference.columns]")
        if self.source.t is not None or (self.reference and self.reference.t is not None):
            raise SurefootError("t is given in [columns] and in [reference.columns]")
        for name, source in self.sources.items():
            if source.t is not None and source.rate is not None:
                raise SurefootError(f"[sources.{name}] has t and rate, of which one is enough")
        referenced = any(name.startswith("ref_") for name in columns)
        if self.reference is not None and referenced:
            raise SurefootError("[columns] has ref_ columns beside a [reference] file")
        self._check_contact(columns)
        model = self.robot.model() if self.robot else {}
        if self.reference is not None or referenced:
            model["ground_evenness"] = self.ground.evenness
        if self.contact is not None:
            model["contact_debounce"] = self.contact.debounce
        clocks = {
            name: read_column(f"sources.{name}.t", "t", source.t, ())
            for name, source in self.sources.items()
            if source.t is not None
        }
        reference = _reference_columns(self.reference, names) if self.reference else {}
        robot = self.robot.name if self.robot else None
        return ImportMap(path, self, columns, clocks, reference, robot, model)

    def _check_contact(self, columns: dict[str, MapColumn]) -> None:
        if self.contact is None:
            return
        if any(name.startswith("contact_") for name in columns):
            raise SurefootError("[contact] is given beside contact_<leg> in [columns]")
        legs = leg_names(columns)
        if self.contact.of == "force":
            if not legs or any(f"force_{leg}" not in columns for leg in legs):
                raise SurefootError("[contact] needs force_<leg> of every leg in [columns]")
            self.contact.by_leg(legs)
        elif not self.robot and (self.contact.of == "torque" or not legs):
            raise SurefootError(f"[contact] of {self.contact.of} needs a [robot]")


def _reference_columns(table: ReferenceTable, sources: tuple[str, ...]) -> dict[str, MapColumn]:
    columns = read_columns("reference.columns", table.columns, sources)
    position, quaternion = GROUPS["reference"][:3], GROUPS["reference"][3:]
    turned = EULER if any(name in columns for name in EULER) else quaternion
    needed = ("t", *position, *turned) if table.rate is None else (*position, *turned)
    for name in needed:
        if name not in columns:
            raise SurefootError(f"[reference.columns] {name} is missing")
    for name, column in columns.items():
        if name not in needed:
            raise SurefootError(
                f"[reference.columns] {name}: only t, ref_p and ref_q go here; a reference with "
                "ref_v goes into [columns] as a whole, and [reference] has no file"
            )
        if column.source:
            raise SurefootError(
                f"[reference.columns] {name} is of another file: give [reference] file"
            )
    return columns
