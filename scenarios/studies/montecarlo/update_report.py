"""The part of the Monte-Carlo report that looks at one coverage update: pictures and two tables."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from surefoot.scenarios.reporting.html import Picture, Section
from surefoot.scenarios.studies.montecarlo.update_figures import remark_figure, update_illustration
from surefoot.scenarios.studies.montecarlo.update_study import Iterated, Remark


def update_pictures() -> dict[str, Picture]:
    """The illustration and the map of the remark, by file name."""
    return {
        "update": Picture(
            update_illustration(),
            "One coverage update on one axis (above) and two (below), as the filter makes it: (a) "
            "the prior, whose mass in the set C is less than gamma; (b) the posterior of Theorem "
            "1, the prior rescaled inside and outside the set; (c) the Gaussian of the same mean "
            "and covariance.",
        ),
        "remark": Picture(
            remark_figure(),
            "Share of the gap gamma - pi that one update closes at gamma 0.8, by place and width "
            "of the box and by correlation (grey: pi >= gamma, nothing to do). It is between 0 and "
            "1 everywhere. Boxes narrower than half a deviation, and those far off, are reached "
            "by a smaller share. On the right the projection is repeated, for cubes of the "
            "given half width and distance.",
        ),
    }


def update_sections(
    remarks: Sequence[Remark], iterated: Sequence[Iterated], pictures: dict[str, Picture]
) -> list[Section]:
    """One update, the paper's remark, and what iterating the projection buys."""
    return [
        Section(
            "One update",
            "The pictures are drawn from the filter's own kernel; free axes have infinite bounds.",
            None,
            (pictures["update"],),
        ),
        Section(
            "The paper's remark: pi < pi+ <= gamma",
            "It is a theorem: the matched Gaussian is a projection of the posterior, and of that "
            "divergence to the prior which the posterior has, gamma's to pi, it takes a part that "
            "leaves pi+ between pi and gamma (`estimator/updates/coverage.py` has the few lines of"
            " the "
            "proof, which needs no box and no Gaussian prior beyond moment matching).\n\n"
            + remark_words(remarks),
            remark_table(remarks),
            (pictures["remark"],),
        ),
        Section(
            "Iterated projections",
            "The projection repeated within one update (`iterations`), bounds at gamma^(1/3), on "
            "the first trials of the tables above. Mean ± standard deviation over trials.\n\n"
            + iteration_words(iterated),
            iteration_table(iterated),
        ),
    ]


def remark_words(remarks: Sequence[Remark]) -> str:
    """What the table says: where the remark holds, and its worst breach elsewhere."""
    exact = [r for r in remarks if np.isfinite(r.after_five)]
    said = (
        f"With exact moments it held on all {sum(r.active for r in exact)} random boxes."
        if all(r.breach is None for r in exact)
        else "With exact moments it FAILED on some boxes: a bug."
    )
    said += (
        f" One update closed {100 * min(r.closed for r in exact):.0f} to "
        f"{100 * max(r.closed for r in exact):.0f} % of the gap on average, five "
        f"{100 * min(r.after_five for r in exact):.0f} to "
        f"{100 * max(r.after_five for r in exact):.0f} %."
    )
    for row in remarks:
        if row.breach is not None:
            broken = 100 * (1 - row.raised) + 100 * (1 - row.within)
            said += (
                f" With {row.way} at gamma {row.gamma:g} it failed on {broken:.2g} % of boxes, by "
                f"most from pi = {row.breach[0]:.5f} to pi+ = {row.breach[1]:.5f}."
            )
    return said


def iteration_words(iterated: Sequence[Iterated]) -> str:
    """RMSE and NEES with the most iterations against one, for each filter and regime."""
    said = []
    for row in iterated:
        group = [r for r in iterated if (r.regime, r.filter) == (row.regime, row.filter)]
        if row is group[-1] and len(group) > 1:
            rmse = [r.scores.rmse.mean() for r in (group[0], row)]
            nees = [r.scores.mean_nees.mean() for r in (group[0], row)]
            said.append(
                f"{row.filter}, {row.regime}: from {group[0].iterations} to {row.iterations} "
                f"projections RMSE {rmse[0]:.3f} -> {rmse[1]:.3f} m, NEES {nees[0]:.1f} -> "
                f"{nees[1]:.1f}."
            )
    return " ".join(said)


def remark_table(remarks: Sequence[Remark]) -> pd.DataFrame:
    """A row for each way and gamma."""
    return pd.DataFrame(
        [
            {
                "update by": r.way,
                "gamma": f"{r.gamma:g}",
                "boxes": r.active,
                "pi+ > pi [%]": f"{100 * r.raised:.2f}",
                "pi+ <= gamma [%]": f"{100 * r.within:.2f}",
                "gap closed [%]": f"{100 * r.closed:.0f}",
                "by five [%]": f"{100 * r.after_five:.0f}" if np.isfinite(r.after_five) else "–",
                "worst breach": f"{r.breach[0]:.5f} -> {r.breach[1]:.5f}" if r.breach else "none",
            }
            for r in remarks
        ]
    )


def iteration_table(iterated: Sequence[Iterated]) -> pd.DataFrame:
    """A row for each regime, filter and number of projections."""
    return pd.DataFrame(
        [
            {
                "regime": r.regime,
                "filter": r.filter,
                "projections": r.iterations,
                "RMSE [m]": f"{r.scores.rmse.mean():.3f} ± {r.scores.rmse.std(ddof=1):.3f}",
                "NEES": f"{r.scores.mean_nees.mean():.2f} ± {r.scores.mean_nees.std(ddof=1):.2f}",
                "active [%]": f"{100 * r.scores.active.mean():.0f}",
            }
            for r in iterated
        ]
    )
