"""Deviations of built robots from their model: each robot (a seed) draws its own, constant
effects.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from zlib import crc32

import numpy as np

from surefoot.sim.common.errors import SurefootError, check_known
from surefoot.sim.common.toml import read_typed
from surefoot.sim.effects import Effect, effect, known_effects
from surefoot.sim.robot.limbs import QUADRUPED, Limbs

LAWS: dict[str, Callable[[np.random.Generator, int], np.ndarray]] = {
    "normal": lambda rng, count: rng.standard_normal(count),
    "uniform": lambda rng, count: rng.uniform(-1.0, 1.0, count),
    "fixed": lambda rng, count: np.ones(count),
}
"""Name of a law -> that many values of size 1 by it."""


@dataclass(frozen=True)
class Imperfection:
    """One kind of effect, with an independent value for each target, by one of three laws.

    Attributes:
        effect: name.
        source: of the size.
        targets: None for each single joint, leg or axis that the robot has.
        normal: standard deviation, in the effect's unit.
        uniform: largest size, of either sign.
        fixed: the size itself.
    """

    effect: str
    source: str
    targets: tuple[str, ...] | None = None
    normal: float | None = None
    uniform: float | None = None
    fixed: float | None = None

    def __post_init__(self):
        known = known_effects()
        check_known("effect", self.effect, known)
        if sum(getattr(self, law) is not None for law in LAWS) != 1:
            raise SurefootError(f"needs one of {', '.join(LAWS)}")
        if self.targets == ():
            raise SurefootError("targets must not be empty")
        for target in self.targets or known[self.effect].single_targets(QUADRUPED)[:1]:
            effect(self.effect, target, getattr(self, self._law))

    @property
    def _law(self) -> str:
        return next(law for law in LAWS if getattr(self, law) is not None)

    def drawn(self, instance: int, limbs: Limbs) -> list[Effect]:
        """Effects of this kind on robot number `instance`, with limbs `limbs`.

        Deterministic, and independent of the other imperfections.
        """
        # A separate random stream, so that adding an imperfection does not change the others.
        rng = np.random.default_rng([instance, crc32(self.effect.encode())])
        kind = known_effects()[self.effect]
        targets = kind.single_targets(limbs) if self.targets is None else self.targets
        draw = LAWS[self._law](rng, len(targets))
        low, high = kind.bounds_on(limbs)
        values = np.clip(getattr(self, self._law) * draw, low, high)
        return [effect(self.effect, t, v) for t, v in zip(targets, values, strict=True)]


@dataclass(frozen=True)
class _File:
    imperfection: tuple[Imperfection, ...] = ()

    def __post_init__(self):
        if not self.imperfection:
            raise SurefootError("are written as [[imperfection]] tables")


def load_imperfections(path: str | Path) -> tuple[Imperfection, ...]:
    """Read the imperfections of a file, `[[imperfection]]` each.

    Raises SurefootError, one line with file, entry and key, if bad.
    """
    return read_typed(path, _File, "imperfections").imperfection
