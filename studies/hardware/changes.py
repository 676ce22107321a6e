"""Detection of a change of a machine since its calibration, from one new run.

A change is one effect on one joint or link. Its size and standard deviation follow from the new
run's rows by generalised least squares, with the covariance of an unchanged run: noise, zeros, the
error of the calibration, and the variation between runs.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline
from scipy.linalg import cho_factor, cho_solve
from scipy.ndimage import gaussian_filter1d
from scipy.stats import norm

from studies.hardware.drives import FIRST
from studies.hardware.impulses import SizeKey, WindowRows, window_rows
from studies.hardware.shared_sizes import Calibration, HeldOutRun
from surefoot import Log
from surefoot.extend import STICTION_RATE, LinkChange, Modelled, known_effects
from surefoot.scenarios.reporting import finished_case

NAMED = 4.0
"""Standard deviations from which a change is reported. The variation between runs is estimated from
four runs only; Student's t exceeds this value once in 36 times, a normal law once in 16 000.
"""
SURE = 1.645
"""Standard deviations above that at which a change is reported in 95 of 100 runs."""
LIKELY = 2.0 * np.log(20.0)
"""Difference of squared standardised sizes at which a change of another link is 20 times less
likely.
"""
KINDS = ("link_mass", "link_com", "coulomb_friction", "encoder_offset")
"""Kinds of the changes that are drawn."""
DRAWN_RATIOS = (0.5, 5.0)
"""Range of a drawn size, relative to the least that is reported in 95 of 100 runs like the one that
it is injected into.
"""
FARTHEST_COM = 0.3
"""Largest plausible offset of a centre of mass [m]: the links are 0.3 m long."""


@dataclass(frozen=True)
class Change:
    """A change of a machine, with its standard deviation."""

    key: SizeKey
    size: float
    deviation: float

    @property
    def excess(self) -> float:
        """Its size in standard deviations."""
        return abs(self.size) / self.deviation

    @property
    def link(self) -> str:
        """The joint that it concerns, or that moves the link that it concerns."""
        return link_of(self.key)

    @property
    def least(self) -> float:
        """The least size that is reported in 95 of 100 runs."""
        return (NAMED + SURE) * self.deviation


def link_of(key: SizeKey) -> str:
    """The joint that an effect concerns, or that moves the link that it concerns."""
    name, target = key
    return target.rsplit("_", 1)[0] if name == "link_com" else target


def every_change(before: Calibration, rows: Sequence[WindowRows]) -> list[Change]:
    """Each possible change, fitted alone to the rows of one new run; the most significant first."""
    factor = cho_factor(before.spread(rows), lower=True)
    rest = cho_solve(factor, before.left(rows))
    found = []
    for key in rows[0].changes:
        x = np.concatenate([log.changes[key].ravel() for log in rows])
        weight = float(x @ cho_solve(factor, x))
        found.append(Change(key, float(x @ rest) / weight, weight**-0.5))
    return sorted(found, key=lambda one: -one.excess)


def named_changes(found: Sequence[Change]) -> tuple[Change, ...]:
    """The changes to report from `every_change`: none, one or, if changes of other links are nearly
    as likely, the best of each such link.
    """
    first = found[0]
    if first.excess < NAMED:
        return ()
    best: dict[str, Change] = {}
    for one in found:
        if one.excess**2 > first.excess**2 - LIKELY:
            best.setdefault(one.link, one)
    return tuple(best.values())


def with_change(log: Log, machine: Modelled, key: SizeKey, size: float) -> Log:
    """Inject a change into a log of the machine, keeping its noise and jolts.

    A zero is added to the angle. For any other change, the torque that it requires along the motion
    is added, also to a passive joint's.

    Args:
        log: as read.
        machine: as declared.
        key: effect and target.
        size: of the effect.
    """
    name, target = key
    j = log.joints.index(link_of(key))
    if name == "encoder_offset":
        return log.with_columns({f"q_{target}": log.q[:, j] + size})
    # Rates computed differently from those of the balance.
    step = float(np.median(np.diff(log.t)))
    t = np.arange(log.t[0], log.t[-1] + step, step)
    q = gaussian_filter1d(CubicSpline(log.t, log.q)(t), FIRST / step, axis=0, mode="nearest")
    smooth = CubicSpline(t, q)
    q, dq, ddq = (smooth(log.t, order) for order in range(3))
    if name == "coulomb_friction":
        added = size * np.tanh(dq / STICTION_RATE) * (np.arange(len(log.joints)) == j)
    else:
        change = LinkChange(j, mass=size)
        if name == "link_com":
            axis = "xyz".index(target[-1])
            change = LinkChange(j, com=tuple(size * np.eye(3)[axis]))
        links = (*machine.extras.links, change)
        changed = replace(machine, extras=replace(machine.extras, links=links))
        added, before = (one.dynamics.inverse(q, dq, ddq)[1] for one in (changed, machine))
        added -= before
    read = enumerate(log.joints)
    return log.with_columns({f"tau_{name}": log.tau[:, k] + added[:, k] for k, name in read})


def drawn_changes(
    done: Sequence[HeldOutRun], each: int, rng: np.random.Generator
) -> list[tuple[str, SizeKey, float]]:
    """Draw changes to inject: run, effect and target, and size, for every kind on every link.

    Sizes are log-uniform within DRAWN_RATIOS of the least that is reported. Offsets of a centre of
    mass beyond FARTHEST_COM are left out. Masses and friction only increase.

    Args:
        done: runs with the calibration by the others.
        each: number of changes of each kind on each link.
        rng: draws runs, axes, sizes and signs.
    """
    least = {one.name: least_changes(one) for one in done}
    drawn = []
    for kind in KINDS:
        for link in done[0].rows[0].joints:
            for _ in range(each):
                run = done[int(rng.integers(len(done)))].name
                keys = [k for k in least[run] if k[0] == kind and link_of(k) == link]
                key = keys[rng.integers(len(keys))]
                low, high = np.array(DRAWN_RATIOS) * least[run][key]
                size = float(np.exp(rng.uniform(np.log(low), np.log(high))))
                sign = rng.choice([-1.0, 1.0]) if kind in ("link_com", "encoder_offset") else 1.0
                if kind != "link_com" or size <= FARTHEST_COM:
                    drawn.append((run, key, sign * size))
    return drawn


def least_changes(one: HeldOutRun) -> dict[SizeKey, float]:
    """The least size of each change that is reported in 95 of 100 runs like this one."""
    return {change.key: change.least for change in every_change(one.others, one.rows)}


@dataclass(frozen=True)
class KeptRows:
    """Folder of finished rows, and the digests of the recordings that they are of."""

    folder: Path
    inputs: Mapping[str, Any]


def tried_changes(
    logs: Mapping[str, Sequence[Log]],
    machine: Modelled,
    done: Sequence[HeldOutRun],
    length: float,
    kept: KeptRows,
    each: int = 5,
) -> list[dict[str, Any]]:
    """Changes found in unchanged runs, in their pieces, and in runs with an injected change.

    Each run is compared with the calibration by the other runs.

    Args:
        logs: by run.
        machine: as declared.
        done: the runs with the calibration by the others.
        length: of the windows [s].
        kept: rows that are finished.
        each: injected changes of each kind on each link.
    """
    others = {one.name: one.others for one in done}
    whole = [(run, slice(None), None, 0.0) for run in logs]
    pieces = [(r, slice(k, k + 1), None, 0.0) for r in logs for k in range(len(logs[r]))]
    drawn = drawn_changes(done, each, np.random.default_rng(0))
    cases = [
        *whole,
        *(piece for piece in pieces if len(logs[piece[0]]) > 1),
        *((run, slice(None), key, size) for run, key, size in drawn),
    ]
    rows = []
    for number, (run, part, key, size) in enumerate(cases):
        own = logs[run][part]

        def judged(run=run, own=own, key=key, size=size) -> dict[str, Any]:
            if key is not None:
                own = [with_change(log, machine, key, size) for log in own]
            windows = [window_rows(log, machine, length) for log in own]
            found = every_change(others[run], windows)
            best = [
                {"key": list(one.key), "size": one.size, "deviation": one.deviation}
                for one in named_changes(found)
            ]
            least = next((one.least for one in found if one.key == key), None)
            return {"named": best, "least": least, "most": found[0].excess}

        name = own[0].name if len(own) < len(logs[run]) else run
        given = {**kept.inputs, "run": name, "key": key, "size": size, "length": length}
        row = finished_case(kept.folder, f"{number:02d}", given, __name__, judged)
        rows.append({"run": name, "key": key, "size": size, **row})
    return rows


def changes_table(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """One row for each case: the change, its size relative to the least that shows, and what was
    reported.
    """
    return pd.DataFrame(
        {
            "run": row["run"],
            "changed": _words(row["key"]) if row["key"] else "nothing",
            "by": _sized(row["key"], row["size"]) if row["key"] else "",
            "of the least named": f"{_ratio(row):.2f}" if row["key"] else "",
            "named": " or ".join(_of(one) for one in row["named"]) or "nothing",
            "verdict": verdict(row),
        }
        for row in rows
    )


def verdict(row: Mapping[str, Any]) -> str:
    """Outcome of a row: right, nothing, not alone (another link is also possible), or wrong."""
    links = [link_of(tuple(one["key"])) for one in row["named"]]
    if not links:
        return "nothing"
    if row["key"] is None or link_of(tuple(row["key"])) not in links:
        return "wrong"
    return "right" if len(links) == 1 else "not alone"


def counts_table(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Number of cases with each outcome, by size, and the number expected from chance alone."""

    def part(words: str, own: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        verdicts = [verdict(row) for row in own]
        ends = ("right", "not alone", "wrong", "nothing")
        counts = {end: verdicts.count(end) for end in ends}
        expected = f"{sum(map(chance_of_a_name, own)):.1f}"
        return {"changed": words, "cases": len(own), "expected named": expected} | counts

    changed = [row for row in rows if row["key"]]
    passes = NAMED / (NAMED + SURE)
    return pd.DataFrame([
        part("at least the least that is named", [r for r in changed if _ratio(r) >= 1.0]),
        part("less, but beyond the threshold", [r for r in changed if passes <= _ratio(r) < 1.0]),
        part("less than the threshold", [r for r in changed if _ratio(r) < passes]),
        part("nothing", [r for r in rows if not r["key"]]),
    ])  # fmt: skip


def chance_of_a_name(row: Mapping[str, Any]) -> float:
    """Probability that the estimate of this case's change exceeds the threshold, given its true
    size and its standard deviation alone; for an unchanged run, with either sign.
    """
    true = (NAMED + SURE) * _ratio(row) if row["key"] else 0.0
    return float(norm.cdf(true - NAMED) + norm.cdf(-true - NAMED))


def least_table(done: Sequence[HeldOutRun]) -> pd.DataFrame:
    """One row for each change: the least size that is reported in 95 of 100 runs, by run."""
    by_run = {one.name: least_changes(one) for one in done}
    return pd.DataFrame(
        {
            "change": _words(key),
            "unit": known_effects()[key[0]].unit,
            **{run: f"{least[key]:.3f}" for run, least in by_run.items()},
        }
        for key in done[0].rows[0].changes
    )


def unchanged_table(by_length: Mapping[float, Sequence[HeldOutRun]]) -> pd.DataFrame:
    """One row for each unchanged run: the most significant change and its size in standard
    deviations, by windows of several lengths [s].
    """
    rows: dict[str, dict[str, str]] = {}
    for length, done in by_length.items():
        for one in done:
            first = every_change(one.others, one.rows)[0]
            row = rows.setdefault(one.name, {"run": one.name})
            row[f"{length:g} s"] = f"{_words(first.key)}, {first.excess:.1f}"
    return pd.DataFrame(rows.values())


def _ratio(row: Mapping[str, Any]) -> float:
    """Ratio of a change's size to the least that is reported in 95 of 100 runs."""
    return abs(row["size"]) / row["least"]


def _words(key: Sequence[str]) -> str:
    return " ".join(key).replace("_", " ")


def _sized(key: Sequence[str], size: float) -> str:
    return f"{size:+.3f} {known_effects()[key[0]].unit}"


def _of(one: Mapping[str, Any]) -> str:
    twice = 1.96 * one["deviation"]
    return f"{_words(one['key'])} {_sized(one['key'], one['size'])} ± {twice:.3f}"
