"""One colour for each estimator, in every figure, recording and report.

The colours of the bundled estimators were found by a search for maximum distance, with and without
red-green blindness, among those legible on a white page and on the dark background of the viewer.
Variants of one estimator also differ in line style, so that a figure is readable in grey.
"""

from typing import Any
from zlib import crc32

from surefoot.scenarios.estimate.estimators import traits

TRUTH = "#8C8C8C"
OBSERVER = "#E69F00"
BOUNDS = "#B8913D"
OUTSIDE = "#B2182B"
STANDING_FOOT = "#6E8CA8"
INK = "#222222"
TRAIN, TEST = "#0072B2", "#D55E00"
BEFORE, AFTER = "#8C8C8C", "#0072B2"

_LEG_COLORS = {"FL": "#DDAA33", "FR": "#CC6677", "RL": "#44AA99", "RR": "#AA66CC"}

_SIDES = {"before": "--", "after": "-"}
"""Lines of one estimator under two models."""
_SPARE_COLORS = ("#AA4499", "#5B6BC0", "#6B8E23", "#A0522D", "#C71585", "#20868F")


def estimator_color(name: str) -> str:
    """Colour '#RRGGBB' of the estimator `name`, the same in every figure.

    One without its own colour gets a spare one determined by its name, so that it is the same in
    every run.
    """
    name, _ = _side(name)
    return traits(name).color or _SPARE_COLORS[crc32(name.encode()) % len(_SPARE_COLORS)]


def estimator_line(name: str) -> str:
    """Matplotlib line style of the estimator `name`: dashed before, solid after."""
    name, side = _side(name)
    if side:
        return _SIDES[side]
    return traits(name).line or "-"


def estimator_look(name: str, note: str = "") -> dict[str, Any]:
    """Colour, line style and label of the estimator `name`, with a note, for `Axes.plot`."""
    label = name + (f" ({note})" if note else "")
    return {"color": estimator_color(name), "linestyle": estimator_line(name), "label": label}


def _side(name: str) -> tuple[str, str]:
    """Name of an estimator and of the case in which it ran: "leg before" is leg, before."""
    base, _, side = name.rpartition(" ")
    return (base, side) if side in _SIDES else (name, "")


def leg_color(name: str) -> str:
    """Colour '#RRGGBB' of a leg; if it is no quadruped's, determined by its name."""
    return _LEG_COLORS.get(name) or _SPARE_COLORS[crc32(name.encode()) % len(_SPARE_COLORS)]


def rgba(color: str, alpha: float = 1.0) -> tuple[int, int, int, int]:
    """'#RRGGBB' and an opacity in [0, 1] as four bytes."""
    r, g, b = (int(color[k : k + 2], 16) for k in (1, 3, 5))
    return r, g, b, round(255 * alpha)


def friction_color(mu: float) -> str:
    """Ground colour: icy blue-white where slippery (mu near 0.1), dull grey where dry (0.8)."""
    share = min(max((mu - 0.1) / 0.7, 0.0), 1.0)
    ice, dry = (0xD6, 0xF3, 0xFF), (0x8A, 0x84, 0x7A)
    return "#" + "".join(f"{round(a + share * (b - a)):02X}" for a, b in zip(ice, dry, strict=True))
