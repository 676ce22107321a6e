"""Numbers with their intervals, as the hardware studies print them."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from surefoot.scenarios.studies.hardware.drives import Sizes


def between(value: float, interval: Sequence[float] | np.ndarray, digits: int = 3) -> str:
    """'0.120 (0.110 – 0.130)'."""
    low, high = interval
    return f"{value:.{digits}f} ({low:.{digits}f} – {high:.{digits}f})"


def size_rows(
    sizes: Sizes, units: Mapping[str, str], alone: Mapping[str, np.ndarray]
) -> pd.DataFrame:
    """A row a term: its size with interval, and what each part of the data says by itself."""
    rows = []
    for i, name in enumerate(sizes.names):
        digits = 4 if name == "armature" else 3
        row = {
            "effect": name.replace("_", " "),
            "unit": units[name],
            "size (95 % interval)": between(sizes.values[i], sizes.interval[i], digits),
        }
        row |= {part: f"{values[i]:.{digits}f}" for part, values in alone.items()}
        rows.append(row)
    return pd.DataFrame(rows)
