"""Run a guide as a reader would: its files, commands and Python, from top to bottom.

`python docs/guide.py docs/guides/compare.md` runs it in the present folder. A block of code with a
title is a file of that name, a `bash` or `python` block is run (the Python of one guide shares its
names), and any other block is output. A block below a comment `<!-- not run: reason -->` is
skipped. A guide that continues another one runs in the folder that the other left.

Nothing is installed: for `pip install --editable .` the entry points of the guide's pyproject.toml
are written beside it, and the folder is on the path of every block.
"""

import os
import re
import subprocess
import sys
import tomllib
import traceback
from dataclasses import dataclass
from pathlib import Path

GUIDES = Path(__file__).resolve().parent / "guides"
FENCE = re.compile(
    r"^```(\w*)(?:\s+title=\"([^\"]+)\")?[^\n]*\n(.*?)^```$", re.MULTILINE | re.DOTALL
)
INSTALL = "pip install --editable ."
NOT_RUN = re.compile(r"<!-- not run: (.+) -->$")
CONTINUES = re.compile(r"^Continues \[[^\]]+\]\((\w+)\.md\)", re.MULTILINE)


@dataclass(frozen=True)
class Block:
    """A block of code: its language, its text, the file that it is, and why it is not run."""

    language: str
    text: str
    line: int
    file: str | None = None
    not_run: str | None = None


def blocks(guide: Path) -> list[Block]:
    """The blocks of code of a guide, in order."""
    page, found = guide.read_text(encoding="utf-8"), []
    for match in FENCE.finditer(page):
        language, file, text = match.groups()
        above = page[: match.start()].rstrip().rpartition("\n\n")[2]
        skip = NOT_RUN.search(above)
        reason = skip.group(1) if skip else None
        found.append(Block(language, text, page.count("\n", 0, match.start()) + 2, file, reason))
    return found


def continued(guide: Path) -> Path | None:
    """The guide whose files this one needs."""
    match = CONTINUES.search(guide.read_text(encoding="utf-8"))
    return GUIDES / f"{match.group(1)}.md" if match else None


def run(guide: Path) -> None:
    """Run a guide here. Raises SystemExit naming file and line of the block that fails."""
    names: dict[str, object] = {"__name__": "__main__"}
    for block in blocks(guide):
        if block.not_run is not None:
            continue
        if block.file is not None:
            Path(block.file).parent.mkdir(parents=True, exist_ok=True)
            Path(block.file).write_text(block.text, encoding="utf-8")
        elif block.language == "bash":
            if INSTALL in block.text:
                _write_entry_points()
            script = ["bash", "-euo", "pipefail", "-c", block.text.replace(INSTALL, ":")]
            if subprocess.run(script, env=_environment(), check=False).returncode:
                raise SystemExit(f"{guide}:{block.line}: this block fails")
        elif block.language == "python":
            try:
                exec(compile("\n" * (block.line - 1) + block.text, guide, "exec"), names)
            except Exception:
                traceback.print_exc()
                raise SystemExit(f"{guide}:{block.line}: this block fails") from None


def _environment() -> dict[str, str]:
    """This interpreter's commands first, and the present folder on Python's path."""
    first = {"PATH": str(Path(sys.executable).parent), "PYTHONPATH": str(Path.cwd())}
    return os.environ | {k: os.pathsep.join([v, os.environ.get(k, "")]) for k, v in first.items()}


def _write_entry_points() -> None:
    """What installing the package of this folder would tell `importlib.metadata`."""
    project = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))["project"]
    name, version = project["name"], project["version"]
    folder = Path(f"{name.replace('-', '_')}-{version}.dist-info")
    folder.mkdir(exist_ok=True)
    metadata = f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n"
    (folder / "METADATA").write_text(metadata, encoding="utf-8")
    lines = []
    for group, points in project["entry-points"].items():
        lines += [f"[{group}]", *(f"{key} = {value}" for key, value in points.items())]
    (folder / "entry_points.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.path.insert(0, "")
    run(Path(sys.argv[1]).resolve())
