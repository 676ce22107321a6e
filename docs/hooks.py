"""Hooks of MkDocs: pages that stand at the root of the repository, and pages made from the code.

README.md becomes the site's first page and CONTRIBUTING.md and CHANGELOG.md pages of it, so that
each text exists once. The page of commands holds what `surefoot COMMAND --help` prints, that of
plausibility the rules of `sim.plausibility`.
"""

import os
import re
import subprocess
import sys
import textwrap
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parent.parent
PAGES = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "SECURITY.md": "security.md",
}
ELSEWHERE = re.compile(r"\[([^\]]+)\]\((?:LICENSE|CITATION\.cff|Makefile)\)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """The pages of docs/, those of the root, the commands, and an index of the results."""
    for source, page in PAGES.items():
        files.append(File.generated(config, page, content=_moved(source)))
    files.append(File.generated(config, "reference/commands.md", content=_commands()))
    files.append(File.generated(config, "reference/plausibility.md", content=_plausibility()))
    files.append(File.generated(config, "results/index.md", content=_results()))
    files.append(File.generated(config, "reference/maps.md", content=_maps()))
    files.append(File.generated(config, "reference/scenario_files.md", content=_scenario_files()))
    filters, effects = _catalogues()
    files.append(File.generated(config, "reference/filters.md", content=filters))
    files.append(File.generated(config, "reference/effects.md", content=effects))
    return files


def _maps() -> str:
    """Every key of an import map."""
    sys.path[:0] = [str(ROOT), str(ROOT / "docs")]
    from keys import keys_page

    from surefoot.sim.importing import columns, map, sections

    units = "\n".join(f"- `{kind}`: {', '.join(one)}" for kind, one in columns.UNITS.items())
    words = (
        "An [import map](../guides/own_log.md) is a TOML file that says what the files and columns"
        " of a recording are. A key that is not listed is an error. Units by kind of column:\n\n"
        + units
    )
    tables = [
        ("The file", map.MapFile),
        ("A column", columns.ColumnEntry),
        ("[source] and [sources.NAME]", sections.Source),
        ("A table with one reading a row", sections.Long),
        ("[reference]", sections.ReferenceTable),
        ("[robot]", sections.RobotTable),
        ("[contact]", sections.ContactTable),
        ("[ground]", sections.GroundTable),
        ("[motor_law]", sections.MotorLaw),
        ("[even]", sections.EvenTable),
    ]
    return keys_page("Import maps", words, tables)


def _scenario_files() -> str:
    """Every key of a scenario's file."""
    sys.path[:0] = [str(ROOT), str(ROOT / "docs")]
    from keys import keys_page

    from surefoot.sim import scenario
    from surefoot.sim.gait.options import GaitOptions
    from surefoot.sim.ground.ground_from_file import GroundFile
    from surefoot.sim.sensors.streams import Sensors

    words = """
    A [scenario](../guides/own_scenario.md) is a TOML file: a course, its ground, and what a seed
    may vary. A key that is not listed is an error.
    """
    tables = [
        ("The file", scenario._File),
        ("[[segment]]", scenario._SegmentEntry),
        ("[ground]", scenario._GroundTable),
        ("[[ground.patch]]", scenario._PatchEntry),
        ("[[ground.strip]]", scenario._StripEntry),
        ("[[ground.height_field]]", GroundFile),
        ("[ranges]", scenario.Ranges),
        ("[gait]", GaitOptions),
        ("[sensors]", Sensors),
    ]
    return keys_page("Scenario files", words, tables)


def _catalogues() -> tuple[str, str]:
    """The filters with their parameters, and the effects."""
    sys.path[:0] = [str(ROOT), str(ROOT / "docs")]
    from catalogues import effects_page, filters_page

    return filters_page(), effects_page()


def _moved(source: str) -> str:
    """A page of the root as it reads inside docs/: links to files outside the site become text."""
    text = (ROOT / source).read_text(encoding="utf-8")
    for other, page in PAGES.items():
        text = text.replace(f"]({other})", f"]({page})")
    return ELSEWHERE.sub(r"`\1`", text).replace("](docs/", "](")


def _results() -> str:
    """One line a page: its title and its main finding."""
    words = (
        "The main finding of each page. The command that measures writes the page, its tables as "
        "CSV, and at the end the commit, the machine and the command."
    )
    rows = [
        f"| [{_title(page)}]({page.name}) | {main_finding(page)} |"
        for page in sorted((ROOT / "docs" / "results").glob("*.md"))
    ]
    lines = ["# Results\n", f"{words}\n", "| page | main finding |", "| --- | --- |", *rows]
    return "\n".join(lines) + "\n"


def main_finding(page: Path) -> str:
    """The first sentence of a page of results."""
    blocks = page.read_text(encoding="utf-8").split("\n\n")
    text = next((one for one in blocks if not one.startswith(("#", "|", "-", "!", "["))), "")
    return re.split(r"(?<=\.)\s+", text.strip(), maxsplit=1)[0]


def _title(page: Path) -> str:
    return page.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")


def _plausibility() -> str:
    """The rules by which a log's numbers are judged."""
    sys.path.insert(0, str(ROOT))
    from surefoot.scenarios.reporting.tables import to_markdown
    from surefoot.sim.plausibility import rules, rules_table

    intro = """`import`, `info`, `estimate`, `compare`, `train`, `calibrate` and `trace` look at
their logs before they use them, and warn of numbers that cannot be, or hardly. `--strict` stops
there. An imported log, a trajectory, an observer, bounds and the reports keep what was warned of.
In Python,
`surefoot.sim.plausibility.check_log` gives the same: columns, evidence, likely cause and, where
they are known, the changes of the import map that correct it. These are relative to the map: a
sign, gain, offset or rotation comes on top of its own. `import`, which has the map, prints whole
lines to put in place of its own, with all changes made."""
    order = str(rules.__doc__).partition("\n\n")[2].strip()
    parts = ["# What is plausible", intro, order, to_markdown(rules_table(), markup=True)]
    return "\n\n".join(parts) + "\n"


def _commands() -> str:
    """What each command prints of itself."""
    sys.path.insert(0, str(ROOT))
    from surefoot.scenarios.cli.main import COMMANDS

    parts = ["# Commands", "Every command, as its `--help` describes it."]
    for name in COMMANDS:
        parts += [f"## surefoot {name}", f"```text\n{_help(name)}\n```"]
    return "\n\n".join(parts) + "\n"


def _help(name: str) -> str:
    made = subprocess.run(
        [sys.executable, "-m", "surefoot", name, "--help"],
        env=os.environ | {"PYTHONPATH": str(ROOT), "NO_COLOR": "1", "COLUMNS": "78"},
        capture_output=True,
        text=True,
        check=True,
    )
    lines = re.sub(r"\x1b\[[0-9;]*m", "", made.stdout).strip().splitlines()
    return "\n".join(textwrap.fill(line, 78) if len(line) > 78 else line for line in lines)
