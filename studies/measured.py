"""The folder of measured recordings, which no repository holds."""

import os
from pathlib import Path


def measured_folder() -> Path:
    """Folder of recordings of real robots: $SUREFOOT_MEASURED, or else `shared/measured` beside the
    checkout; it need not exist.
    """
    chosen = os.environ.get("SUREFOOT_MEASURED")
    checkout = Path(__file__).resolve().parents[1]
    return Path(chosen) if chosen else checkout.parent / "shared" / "measured"
