"""Open a recording in the rerun viewer, on this screen or in a browser on this machine."""

import subprocess
import sys
from pathlib import Path

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import check_unchanged, is_file

_MAGIC = (b"RRF2", b"RRIO")  # the first bytes of every .rrd since rerun 0.2


def view(path: str | Path, web: bool = False) -> None:
    """Show the recording until the viewer (or, with `web`, the server) is closed.

    The server listens on 127.0.0.1 only. Raises SurefootError where `path` is missing or is no
    recording, or where the viewer ends with an error.
    """
    file = recording_file(path)
    how = "--web-viewer" if web else "--new"
    command = [sys.executable, "-m", "rerun", how, "--bind", "127.0.0.1", str(file)]
    try:
        code = subprocess.run(command, check=False).returncode
    except KeyboardInterrupt:
        return
    if code != 0:
        hint = "" if web else "; without a screen, try web"
        raise SurefootError(f"{file}: the rerun viewer ended with exit code {code}{hint}")


def recording_file(path: str | Path) -> Path:
    """The path, if it is a rerun recording. Raises SurefootError in one line if not."""
    file = Path(path)
    if not is_file(file):
        raise SurefootError(f"{file}: {'is a folder' if file.is_dir() else 'no such file'}")
    if file.suffix != ".rrd":
        raise SurefootError(
            f"{file}: not a recording; the command `surefoot view` opens recordings (.rrd), logs "
            "(.parquet) and scenarios (.toml), `surefoot robots FILE -o PICTURE.png` draws a robot"
        )
    with file.open("rb") as stream:
        start = stream.read(4)
    if start not in _MAGIC:
        raise SurefootError(f"{file}: named .rrd, but is not a rerun recording")
    check_unchanged(file)
    return file
