"""Check of the first bytes of a log's file, without slow imports."""

from pathlib import Path

from surefoot.sim.common.errors import SurefootError

MAGIC = b"PAR1"
"""First bytes of a Parquet file."""


def check_first_bytes(path: Path) -> None:
    """Raise SurefootError for a recording that has still to be imported, and for a Parquet file
    that is damaged in its first bytes.
    """
    with path.open("rb") as stream:
        if stream.read(len(MAGIC)) == MAGIC:
            return
    if path.suffix == ".parquet":
        raise SurefootError(f"{path}: not a whole Parquet file, damaged in its first bytes")
    raise SurefootError(
        f"{path}: not a log, which is a Parquet file; `surefoot import` makes one of it"
    )
