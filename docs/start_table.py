"""Write the table of starts into the guide on comparisons, between its markers.

`python docs/start_table.py` (or `make readme`): a walk whose robot stands at first is estimated as
a whole, and without what precedes its walk, from each start.
"""

from pathlib import Path

from readme_table import with_table

from surefoot import FilterSettings, Log, Robot, Scenario, StartSettings, run_filter, walk
from surefoot.estimator.initial import Start
from surefoot.scenarios.reporting.pages import origin_of
from surefoot.scenarios.reporting.tables import to_markdown

GUIDE = Path(__file__).resolve().parent / "guides" / "compare.md"
MARKERS = "<!-- table of starts: made by `make readme` -->", "<!-- end of the table -->"
WALKS_FROM = 3.0
"""Time after which the robot walks steadily [s]."""
CASES: tuple[tuple[str, Start], ...] = (
    ("standing", "reference"),
    ("standing", "rest"),
    ("walking", "reference"),
    ("walking", "moving"),
    ("walking", "rest"),
)


def row(log: Log, robot: Robot, case: tuple[str, Start]) -> dict[str, object]:
    """Errors of two filters on a log that begins standing or walking."""
    begins, kind = case
    part = log if begins == "standing" else log.rows(log.t >= log.t[0] + WALKS_FROM)
    values: dict[str, object] = {"the log begins": begins, "`--start`": f"`{kind}`"}
    settings = FilterSettings(start=StartSettings(kind=kind))
    for name in ("leg", "imu"):
        found = run_filter(name, part, robot, settings=settings).metrics
        assert found is not None  # the log has a reference
        values[f"`{name}`: APE_trans [m]"] = found.ape_trans
        values[f"`{name}`: APE_rot [deg]"] = found.ape_rot
    return values


def table() -> str:
    """The table, and what it was measured on."""
    robot = Robot.load("spot_class")
    log = walk(Scenario.load("demo/walk"), robot, 2)
    made = origin_of("surefoot.estimator.initial", "make readme")
    rows = to_markdown([row(log, robot, case) for case in CASES], markup=True)
    return f"\n{rows}\n\nMade by `{made.command}` on commit `{made.commit}`, {made.date}.\n"


if __name__ == "__main__":
    written = with_table(GUIDE.read_text(encoding="utf-8"), table(), *MARKERS)
    GUIDE.write_text(written, encoding="utf-8")
