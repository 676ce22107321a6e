"""A scenario file of one segment, for tests that need any walk."""

from pathlib import Path

COURSE = """
name = "short"
robot = "spot_class"
[[segment]]
duration = {seconds}
forward = 0.5
"""


def course_file(folder: Path, seconds: float, more: str = "") -> Path:
    """`short.toml`: spot_class goes ahead for so long; `more` are further keys and tables."""
    path = folder / "short.toml"
    path.write_text(COURSE.format(seconds=seconds) + more)
    return path
