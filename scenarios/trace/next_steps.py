"""What to do after a trace: commands in order, for each verdict."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from shlex import join

from surefoot.scenarios.reporting.html import Step
from surefoot.scenarios.trace.result import Trace
from surefoot.sim.robot.catalog import known_robots
from surefoot.sim.robot.machine import Machine

_SUSPECTED = ("link_length", "encoder_offset", "foot_rolling")
"""Effects to plan a recording for where a trace names none."""


@dataclass(frozen=True)
class TraceFiles:
    """Files of a trace, as commands name them.

    Attributes:
        logs: that were fitted.
        out: folder of the results.
        robot: name or file; None where the logs name it.
        declared: file of the effects that were declared.
        holdout: logs that no fit has seen.
    """

    logs: Sequence[Path]
    out: Path
    robot: str | None = None
    declared: Path | None = None
    holdout: Sequence[Path] = ()

    def command(self, name: str, *arguments: str | Path, out: str) -> str:
        """A command about this robot, whose results are written beside those of the trace."""
        robot = ("--robot", self.robot) if self.robot else ()
        return _line(name, *arguments, *robot, "-o", self.beside(out))

    def beside(self, name: str) -> Path:
        """A path beside the results."""
        return self.out.with_name(f"{self.out.name}_{name}")


def next_steps(found: Trace, files: TraceFiles, robot: Machine) -> tuple[Step, ...]:
    """What to do next, in order. Names in capitals are of logs that are still to be recorded."""
    logs, seen = files.logs, files.holdout or files.logs
    declared = ("--declared", files.declared) if files.declared else ()
    more = Step(
        "Trace it together with the present logs",
        files.command("trace", *logs, "NEW.parquet", *declared, out="more"),
    )
    filters, effects = bool(found.filters), files.out / "effects.toml"
    use: list[Step] = []
    if files.declared and found.effects:
        effects = files.beside("model.toml")
        both = f"cat {join([str(files.declared), str(files.out / 'effects.toml')])}"
        joined = Step("Join the effects with the declared ones", f"{both} > {join([str(effects)])}")
        use.append(joined)
    if filters and found.effects:
        compared = files.command("compare", *seen, "--effects", effects, out="compared")
        sure = found.verdict == "attributed"
        words = "Run the filters with the effects" if sure else "See whether filters gain by them"
        use.append(Step(words, compared))
    plan = ""
    if robot.legged and len(robot.limbs.legs) == 4 and robot.limbs.point_feet:
        known = robot.legged.name in known_robots()
        names = [*(one.name for one in found.effects), *(rival["name"] for rival in found.rivals)]
        named = files.robot or (robot.legged.name if known else robot.legged.file)
        plan = _line("plan", "--robot", named, *dict.fromkeys(names or _SUSPECTED))
    if found.verdict == "attributed":
        unseen = "--holdout", "OTHER.parquet"
        check = files.command("trace", *logs, *declared, *unseen, out="checked")
        since = files.command("trace", "NEW.parquet", "--declared", effects, out="since")
        first = [] if files.holdout else [Step("Check them on a log that no fit has seen", check)]
        return (*first, *use, Step("Find later what has changed since", since))
    if found.verdict == "confounded":
        return (Step("Record what distinguishes them", plan), more, *use)
    if found.verdict == "none_of_these":
        align = files.command("align", logs[0], out="aligned")
        aligned = [Step("Check clock and place of the reference", align)] if filters else []
        return (
            Step("Check stamps, signs and contacts of the log", _line("info", logs[0])),
            *aligned,
            *use,
            Step("Write what remains as an effect of your own (docs/guides/own_effect.md)"),
        )
    if found.verdict == "not_identifiable":
        return Step("Record more", plan), more
    if found.verdict == "no_residual":
        compared = files.command("compare", *seen, out="compared")
        drifts = [Step("See which filter drifts all the same", compared)] if filters else []
        return (*drifts, Step("To find smaller effects, record more", plan), more)
    new = files.command("trace", "NEW.parquet", *declared, out="next")
    return (Step("Compare the next run with them in the same way", new),)


def _line(name: str, *arguments: str | Path) -> str:
    return join(["surefoot", name, *map(str, arguments)])
