"""One colour and one name for each estimator, in every figure, recording and report.

The colours of the bundled estimators are those that a search found furthest apart, seen with and
without red-green blindness, of those legible on the white of a page and on the dark background of
the viewer; variants of one estimator differ in line style too, so that a picture printed in grey
can still be read.
"""

from zlib import crc32

from surefoot.scenarios.estimate.estimators import ESTIMATORS, traits

TRUTH = "#8C8C8C"
OBSERVER = "#E69F00"
BOUNDS = "#B8913D"
OUTSIDE = "#EE3377"
STANDING_FOOT = "#6E8CA8"
INK = "#222222"
TRAIN, TEST = "#2E8B57", "#C8102E"
BEFORE, AFTER = "#8C8C8C", "#0072B2"

_LEG_COLORS = {"FL": "#DDAA33", "FR": "#CC6677", "RL": "#44AA99", "RR": "#AA66CC"}

_STYLES: dict[str, tuple[str, str, str]] = {
    "leg (declared model)": ("Leg IEKF, declared model", "#8CBBEA", "--"),
    "leg (effect added)": ("Leg IEKF, effect added", "#2F86D1", "-"),
}
"""Beside the estimators, which say their own: one estimator under two models."""
_SIDES = {"before": "--", "after": "-"}
_SPARE_COLORS = ("#AA4499", "#5B6BC0", "#6B8E23", "#A0522D", "#C71585", "#20868F")
_SPARE_STYLES = ("-", "--", "-.", ":")


def estimator_label(name: str) -> str:
    """The words a reader sees for the estimator `name`; an unknown name is its own label."""
    base, side = _side(name)
    label = _style(base)[0] or base
    return f"{label}, {side}" if side else label


def estimator_color(name: str) -> str:
    """The colour '#RRGGBB' of the estimator `name`, the same in every picture.

    One that has no colour of its own gets a spare one chosen by its name alone, so that it keeps
    it from one run to the next.
    """
    name, _ = _side(name)
    return _style(name)[1] or _SPARE_COLORS[crc32(name.encode()) % len(_SPARE_COLORS)]


def estimator_line(name: str) -> str:
    """The matplotlib line style of the estimator `name`: dashed before, solid after."""
    name, side = _side(name)
    if side:
        return _SIDES[side]
    spare = crc32(name.encode()) // len(_SPARE_COLORS) % len(_SPARE_STYLES)
    return _style(name)[2] or _SPARE_STYLES[spare]


def _style(name: str) -> tuple[str, str, str]:
    """Label, colour and line that an estimator says of itself; empty where it says nothing."""
    if name in _STYLES:
        return _STYLES[name]
    if name not in ESTIMATORS:
        return "", "", ""
    own = traits(name)
    return ESTIMATORS[name].label, own.color, own.line


def _side(name: str) -> tuple[str, str]:
    """An estimator's name and which of two worlds it ran in: "leg before" is leg, before."""
    base, _, side = name.rpartition(" ")
    return (base, side) if side in _SIDES else (name, "")


def leg_color(name: str) -> str:
    """The colour '#RRGGBB' of a leg; of one that is no quadruped's, chosen by its name."""
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
