"""A scenario file of one segment, for tests that need any walk."""

from pathlib import Path

COURSE = """
name = "{name}"
robot = "spot_class"
role = "{role}"
[[segment]]
duration = {seconds}
forward = {forward}
"""


def course_file(
    folder: Path,
    seconds: float,
    more: str = "",
    name: str = "short",
    role: str = "test",
    forward: float = 0.5,
) -> Path:
    """`NAME.toml`: spot_class goes ahead for so long; `more` are further keys of the segment and
    tables after it.
    """
    path = folder / f"{name}.toml"
    text = COURSE.format(name=name, role=role, seconds=seconds, forward=forward)
    path.write_text(text + more)
    return path
