"""Logs of next to nothing: every command that reads a log works on them, or refuses in one line."""

from collections.abc import Callable

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from forked import copied, run_forked

Change = Callable[[pd.DataFrame], pd.DataFrame]


def rows(*which: int) -> Change:
    """The rows of a slice."""
    return lambda c: c.iloc[slice(*which)]


def without(*starts: str) -> Change:
    return lambda c: c.filter([name for name in c if not name.startswith(starts)])


def only(*starts: str) -> Change:
    return lambda c: c.filter([name for name in c if name == "t" or name.startswith(starts)])


def held(*starts: str, at: float | None = None) -> Change:
    """Columns of one value: `at`, or that of their first row."""

    def change(c: pd.DataFrame) -> pd.DataFrame:
        names = [name for name in c if name.startswith(starts)]
        return c.assign(**{name: c[name].iloc[0] if at is None else at for name in names})

    return change


def reference_in(*which: int | None) -> Change:
    """A reference that was measured in the rows of a slice alone."""
    return lambda c: c.assign(ref_ok=np.isin(range(len(c)), range(len(c))[slice(*which)]) * 1.0)


GROUPS = ("gyro_", "accel_", "q_", "dq_", "tau_", "contact_", "ref_p", "ref_q", "ref_")
LOGS: dict[str, tuple[Change, ...]] = {
    **{f"{n} rows": (rows(n),) for n in (0, 1, 2, 3, 5, 10)},
    **{f"{n} rows without a reference": (rows(n), without("ref_")) for n in (3, 10)},
    **{f"{n} rows of an IMU": (rows(n), only("gyro_", "accel_")) for n in (3, 10)},
    "0.1 s": (rows(50),),
    "0.1 s of legs that feel nothing": (rows(50), held("contact_", at=0.0), without("ref_")),
    **{f"no number in {one}": (held(one, at=float("nan")),) for one in GROUPS},
    **{f"zeros in {one}": (held(one, at=0.0),) for one in GROUPS},
    **{f"without {one}": (without(one),) for one in (*GROUPS, "q_", "dq_")},
    "no legs": (without("q_", "dq_", "tau_", "contact_"),),
    "a reference of one row": (reference_in(1),),
    "a reference of the last row": (reference_in(-1, None),),
    "a reference of no row": (reference_in(0),),
    "a position that stands": (held("ref_p", "ref_v"),),
    "a reference that stands": (held("ref_"),),
    "nothing moves": (held(*GROUPS),),
    "times alone": (only("none"),),
    "a reference alone": (only("ref_"),),
    "contacts alone": (only("contact_"),),
    "an IMU alone": (only("gyro_", "accel_"),),
    "IMU and reference": (only("gyro_", "accel_", "ref_"),),
}
LEARNT = "--observer observer.safetensors --bounds bounds.json"
COMMANDS = (
    "info walk.parquet --json",
    *(f"estimate walk.parquet --filter {name}" for name in ("imu", "leg", "leg_slip", "radar_leg")),
    *(f"estimate walk.parquet --filter {name} {LEARNT}" for name in ("coverage", "velocity")),
    *(f"export walk.parquet -o new{kind}" for kind in (".tum", ".csv", ".mcap")),
    "view walk.parquet -o new.rrd",
    "align walk.parquet -o new",
    "noise walk.parquet",
    "calibrate observer.safetensors walk.parquet -o new.json",
    "train walk.parquet -o new.safetensors --epochs 1",
    "compare walk.parquet -o new",
    "realism walk.parquet -o new",
    "trace walk.parquet -o new",
)
SLOW = ("compare", "realism", "trace")
"""Commands that simulate or draw for longer than a refusal may take: they must not end badly."""
SAMPLE = 100
"""Every so many cases are run by `make test`."""
CASES = [(log, command) for log in LOGS for command in COMMANDS]


@pytest.mark.parametrize(
    ("log", "command"),
    [
        pytest.param(*case, marks=() if number % SAMPLE == 0 else (pytest.mark.slow,))
        for number, case in enumerate(CASES)
    ],
)
def test_a_log_of_next_to_nothing_is_read_or_refused_in_one_line(log, command, good, tmp_path):
    folder = copied(good, tmp_path / "case")
    table = pq.read_table(folder / "walk.parquet")
    frame = table.to_pandas()
    for change in LOGS[log]:
        frame = change(frame)
    made = pa.Table.from_pandas(frame, preserve_index=False)
    about = {b"surefoot": table.schema.metadata[b"surefoot"]}
    pq.write_table(made.replace_schema_metadata(about), folder / "walk.parquet")
    found = run_forked(command.split(), folder, memory=2_000_000_000)
    if found.code == -24 and command.startswith(SLOW):
        pytest.skip("works on it for longer than a refusal may take")
    said = [x for x in found.err.splitlines() if not x.startswith(("warning: ", "note: "))]
    assert found.code in (0, 1, 2, 3), found
    assert "Warning" not in found.err, found
    assert len(said) == (found.code != 0), found
