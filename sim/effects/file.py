"""Files of effects: TOML with one [[effect]] of name, target, value and unit each."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import protect, write_whole
from surefoot.sim.common.toml import read_typed
from surefoot.sim.effects.base import Effect
from surefoot.sim.effects.catalogue import effect
from surefoot.sim.robot.limbs import Limbs


@dataclass(frozen=True)
class _Entry:
    name: str
    target: str
    value: float
    unit: str

    def __post_init__(self):
        unit, of_slides = self.effect.unit, self.effect.unit_of_slides()
        if self.unit not in (unit, of_slides):
            other = f", or '{of_slides}' of a slide" if of_slides != unit else ""
            raise SurefootError(f"unit of {self.name} must be '{unit}'{other}, is '{self.unit}'")

    @property
    def effect(self) -> Effect:
        return effect(self.name, self.target, self.value)


@dataclass(frozen=True)
class _File:
    effect: tuple[_Entry, ...] = ()

    def __post_init__(self):
        seen: set[tuple[str, str]] = set()
        for number, key in enumerate(((e.name, e.target) for e in self.effect), 1):
            if key in seen or seen.add(key):
                raise SurefootError(f"[[effect]] {number} {key[0]} of {key[1]} is there twice")


def load_effects(path: str | Path) -> tuple[Effect, ...]:
    """Read the effects of a file. Raises SurefootError, one line with file, entry and key, if
    bad.
    """
    protect(path)
    return tuple(entry.effect for entry in read_typed(path, _File, "effects").effect)


def save_effects(path: str | Path, effects: Sequence[Effect], limbs: Limbs | None = None) -> None:
    """Write the effects so that `load_effects` returns them, value for value.

    limbs: of their machine, for the units of joints that slide.
    """
    write_whole(path, to_toml(effects, limbs))


def to_toml(effects: Sequence[Effect], limbs: Limbs | None = None) -> str:
    """Text of an effects file; without effects, a comment."""
    if not effects:
        return "# no effects\n"
    return "\n".join(
        f'[[effect]]\nname = "{e.name}"\ntarget = "{e.target}"\n'
        f'value = {float(e.value)!r}\nunit = "{e.unit_on(e.target, limbs) if limbs else e.unit}"\n'
        for e in effects
    )
