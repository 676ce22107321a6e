"""Pages that list the filters, and the effects with the channels they show in, made from their
classes.
"""

from surefoot.models.residuals.channels import CHANNELS
from surefoot.scenarios.estimate.estimators import ESTIMATORS, estimator_named
from surefoot.scenarios.reporting.tables import to_markdown
from surefoot.sim.effects import CATALOGUE
from surefoot.sim.effects.base import Part
from surefoot.sim.robot.limbs import QUADRUPED


def filters_page() -> str:
    """The filters, what each needs, and its parameters."""
    filters, users = [], {}
    for name in ESTIMATORS:
        one = estimator_named(name)
        needed = [*one.needs.log, *(("feet",) if one.needs.feet else ()), *one.needs.learnt]
        row = {
            "filter": f"`{name}`",
            "method": one.description,
            "needs": ", ".join(needed),
        }
        filters.append(row)
        for each in one.parameters:
            users.setdefault(each, []).append(f"`{name}`")
    parameters = [
        {
            "parameter": f"`{each.name}`",
            "default": f"{each.default:g}",
            "unit": each.unit,
            "meaning": each.meaning,
            "of": ", ".join(names),
        }
        for each, names in users.items()
    ]
    parts = [
        "# Filters",
        "The names for `--filter`. *gml* observers are trained with `--loss gml`, *mse* observers "
        "with `--loss mse`; *persistent* is the part of the bounds that describes persistent "
        "errors. Yours are added as [own estimator](../guides/own_estimator.md) describes.",
        to_markdown(filters, markup=True),
        "## Parameters",
        "Set them by `--set filters.leg.contact=0.015`, or in a [file of settings]"
        "(../guides/compare.md#where-do-the-covariances-come-from). For the bundled robots, "
        "`surefoot/scenarios/estimate/tuned.toml` replaces some of these defaults.",
        to_markdown(parameters, markup=True),
    ]
    return "\n\n".join(parts) + "\n"


def effects_page() -> str:
    """The effects, their units, bounds and targets."""
    rows = []
    for name, effect in CATALOGUE.items():
        low, high = effect.bounds
        targets = effect.targets if isinstance(effect.targets, tuple) else (_PARTS[effect.targets],)
        shared = " or a group" if effect.group_targets(QUADRUPED) else ""
        rows.append(
            {
                "effect": f"`{name}`",
                "what it is": _summary(effect),
                "unit": effect.unit,
                "from": f"{low:g}",
                "to": f"{high:g}",
                "target": ", ".join(targets) + shared,
            }
        )
    parts = [
        "# Effects",
        "What a real robot may have and its model may lack: [`simulate --effects`]"
        "(../guides/simulate.md#robots-that-differ-from-their-model) adds them, "
        "[`trace`](../guides/trace.md) looks for them. Sizes are within the bounds below. "
        "Yours are added as [own effect](../guides/own_effect.md) describes.",
        to_markdown(rows, markup=True),
        "## Channels",
        "The residuals in which `trace` sees them, and the columns of the log that each needs. "
        "Yours are added as [own channel](../guides/own_channel.md) describes.",
        to_markdown(
            [
                {
                    "channel": f"`{name}`",
                    "what it is": _summary(channel),
                    "unit": channel.unit,
                    "needs": ", ".join(channel.needs),
                }
                for name, channel in CHANNELS.items()
            ],
            markup=True,
        ),
    ]
    return "\n\n".join(parts) + "\n"


def _summary(kind: type) -> str:
    """First paragraph of a class's documentation, in one line."""
    return " ".join(str(kind.__doc__).split("\n\n")[0].split())


_PARTS: dict[Part, str] = {
    "joint": "a joint (`FL_calf`)",
    "link": "a link, by the joint that moves it (`FL_calf`)",
    "link_axis": "a link along an axis of its body (`FL_calf_x`)",
    "leg": "a leg (`FL`)",
    "leg_link": "a link of a leg, by the joint at its upper end (`FL_calf`)",
    "leg_axis": "a leg along an axis of the base (`FL_x`)",
}
