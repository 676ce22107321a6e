"""What to do after a trace: commands in order, for each verdict."""

from pathlib import Path
from shlex import join

from surefoot.scenarios.reporting.html import Step
from surefoot.scenarios.settings import TraceSettings
from surefoot.scenarios.trace.result import Trace
from surefoot.sim.common.plugins import next_command
from surefoot.sim.robot.catalog import known_robots
from surefoot.sim.robot.machine import Machine

_SUSPECTED = ("link_length", "encoder_offset", "foot_rolling")
"""Effects to plan a recording for where a trace names none."""


def next_steps(found: Trace, files: TraceSettings, robot: Machine) -> tuple[Step, ...]:
    """What to do next, in order. Names in capitals are of logs that are still to be recorded."""

    def beside(name: str) -> Path:
        return files.out.with_name(f"{files.out.name}_{name}")

    def command(name: str, *arguments: str | Path, out: str) -> str:
        of_robot = ("--robot", files.robot) if files.robot else ()
        return next_command(name, *arguments, *of_robot, "-o", beside(out))

    seen, filters = files.holdout or files.logs, bool(found.filters)
    declared = ("--declared", files.declared) if files.declared else ()
    more = command("trace", *files.logs, "NEW.parquet", *declared, out="more")
    again, plan = Step("Trace it together with the present logs", more), ""
    if robot.legged and len(robot.limbs.legs) == 4 and robot.limbs.point_feet:
        known = robot.legged.name in known_robots()
        named = files.robot or (robot.legged.name if known else robot.legged.file)
        names = [*(one.name for one in found.effects), *(rival["name"] for rival in found.rivals)]
        plan = next_command("plan", "--robot", named, *dict.fromkeys(names or _SUSPECTED))
    effects = files.out / "effects.toml"
    use: list[Step] = []
    if files.declared and found.effects:
        both, effects = join([str(files.declared), str(effects)]), beside("model.toml")
        joined = f"cat {both} > {join([str(effects)])}"
        use.append(Step("Join the effects with the declared ones", joined))
    if filters and found.effects:
        sure = found.verdict == "attributed"
        words = "Run the filters with the effects" if sure else "See whether filters gain by them"
        use.append(Step(words, command("compare", *seen, "--effects", effects, out="compared")))
    if found.verdict == "attributed":
        # Runs that are compared with unchanged ones are so one by one.
        fitted = () if found.least else (*files.logs, "--holdout")
        check = command("trace", *fitted, "OTHER.parquet", *declared, out="checked")
        first = [] if files.holdout else [Step("Check them on a log that no fit has seen", check)]
        since = command("trace", "NEW.parquet", "--declared", effects, out="since")
        return (*first, *use, Step("Find later what has changed since", since))
    if found.verdict == "confounded":
        return (Step("Record what distinguishes them", plan), again, *use)
    if found.verdict == "none_of_these":
        align = Step(
            "Check clock and place of the reference", command("align", files.logs[0], out="aligned")
        )
        legs = not robot.fixed and any(not name.startswith("imu") for name in found.channels)
        rejected = Step(f"See in {files.out / 'report.html'} what was rejected, and why")
        words = f"Check stamps{', signs and contacts' if legs else ' and signs'} of the log"
        check = next_command("info", files.logs[0], *(["--contacts"] if legs else []))
        return (
            Step(words, check),
            *([align] if filters else []),
            *use,
            *([rejected] if found.rejected else []),
            Step("Write what remains as an effect of your own, see the guide 'Your own effect'"),
        )
    if found.verdict == "not_identifiable":
        return Step("Record more", plan), again
    if found.verdict == "no_residual":
        drifts = Step(
            "See which filter drifts all the same", command("compare", *seen, out="compared")
        )
        smaller = Step(f"Record more to find {_unseen(found)}", plan)
        return (*([drifts] if filters else []), smaller, again)
    new = command("trace", "NEW.parquet", *declared, out="next")
    return (Step("Compare the next run with them in the same way", new),)


def _unseen(found: Trace) -> str:
    """The suspected effects below the sizes from which they would have been named on any part."""
    least: dict[str, tuple[float, str]] = {}
    for one in found.rounds[0] if found.rounds else ():
        name, target = one.key
        if name in _SUSPECTED and one.least > least.get(name, (0.0, ""))[0]:
            least[name] = one.least, found.unit_of(name, target)
    sizes = [f"{name} below {size:.2g} {unit}" for name, (size, unit) in least.items()]
    return ", ".join(sizes) or "smaller effects"
