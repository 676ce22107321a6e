"""What sets a robot as built apart from its drawing: each instance draws its own, once for life."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.toml import read_toml
from surefoot.sim.effects import Effect, effect, known_effects

KEYS = ("effect", "targets", "normal", "uniform", "fixed", "source")
LAWS = ("normal", "uniform", "fixed")


@dataclass(frozen=True)
class Imperfection:
    """One effect on some targets, each drawn for itself.

    law: "normal" (standard deviation `size`), "uniform" (within +-`size`) or "fixed" (`size`), in
    the effect's unit. source: where the size comes from.
    """

    effect: str
    targets: tuple[str, ...]
    law: str
    size: float
    source: str

    def drawn(self, instance: int) -> list[Effect]:
        """The effects that robot number `instance` has of this kind: the same at every call."""
        # A stream of its own: one imperfection more does not change the others.
        rng = np.random.default_rng([instance, crc32(self.effect.encode())])
        shares = {"normal": rng.standard_normal, "uniform": lambda n: rng.uniform(-1.0, 1.0, n)}
        draw = shares.get(self.law, np.ones)(len(self.targets))
        low, high = known_effects()[self.effect].bounds
        values = np.clip(self.size * draw, low, high)
        return [effect(self.effect, t, v) for t, v in zip(self.targets, values, strict=True)]


def load_imperfections(path: str | Path) -> tuple[Imperfection, ...]:
    """The imperfections of a file, `[[imperfection]]` each.

    Raises SurefootError, one line with file, entry and key, if bad.
    """
    path = Path(path)
    table = read_toml(path, "imperfections")
    entries = table.get("imperfection", [])
    if set(table) - {"imperfection"} or not isinstance(entries, list) or not entries:
        raise SurefootError(
            f"imperfections {path}: are written as [[imperfection]] tables, and nothing else"
        )
    found = []
    for number, entry in enumerate(entries, 1):
        try:
            found.append(_imperfection(entry))
        except SurefootError as error:
            raise SurefootError(
                f"imperfections {path}: [[imperfection]] {number}: {error}"
            ) from None
    return tuple(found)


def _imperfection(entry: dict[str, Any]) -> Imperfection:
    unknown = sorted(set(entry) - set(KEYS))
    if unknown:
        raise SurefootError(f"unknown key '{unknown[0]}'; known: {', '.join(KEYS)}")
    name = str(entry.get("effect"))
    if name not in known_effects():
        raise SurefootError(f"unknown effect '{name}'; known: {', '.join(known_effects())}")
    laws = [law for law in LAWS if law in entry]
    if len(laws) != 1:
        raise SurefootError(f"needs one of {', '.join(LAWS)}")
    size = entry[laws[0]]
    if isinstance(size, bool) or not isinstance(size, int | float) or not np.isfinite(size):
        raise SurefootError(f"{laws[0]} must be a number, is {size!r}")
    if not isinstance(entry.get("source"), str):
        raise SurefootError("needs source: where the size comes from")
    targets = entry.get("targets", list(known_effects()[name].targets))
    if not isinstance(targets, list) or not targets:
        raise SurefootError("targets must be a list of names")
    for target in targets:
        effect(name, str(target), float(size))
    return Imperfection(name, tuple(targets), laws[0], float(size), entry["source"])
