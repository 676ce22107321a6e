"""A file of these contents, which a test then reads."""

from pathlib import Path


def written(path: Path, content: str | bytes) -> Path:
    """The path, at which the contents are now."""
    if isinstance(content, str):
        path.write_text(content)
    else:
        path.write_bytes(content)
    return path
