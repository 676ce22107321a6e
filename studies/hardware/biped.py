"""A biped with flat feet: filters on its measured walk and sway."""

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from surefoot import Log, Robot, run_filter
from surefoot.extend import reference
from surefoot.scenarios.reporting import AFTER, BEFORE, INK, legend_below, new_figure

ICUB_RUNS = ("walking", "com_sinusoid")
FILTERS = ("leg", "leg_slip", "imu")


def filters_table(logs: Mapping[str, Log], robot: Robot) -> pd.DataFrame:
    """One row for each log and filter: its errors and its consistency."""
    rows = []
    for run, log in logs.items():
        for name in FILTERS:
            found = run_filter(name, log, robot).metrics
            assert found is not None
            rows.append(
                {
                    "log": run,
                    "filter": name,
                    "APE_trans [m]": f"{found.ape_trans:.4f}",
                    "RPE_trans [m]": _or_dash(found.rpe_trans, 4),
                    "APE_rot [deg]": f"{found.ape_rot:.2f}",
                    "NEES_pos": f"{found.nees_position:.3f}",
                }
            )
    return pd.DataFrame(rows)


def walk_figure(log: Log, robot: Robot) -> Figure:
    """Position over time: the reference and the leg filters."""
    drawn, axes = new_figure(3, 1, (8.0, 6.0))
    truth = reference(log)
    paths = {"motion capture": (truth.t, truth.p_GI, INK)}
    for name, color in (("leg", AFTER), ("leg_slip", BEFORE)):
        found = run_filter(name, log, robot).trajectory
        paths[name] = found.t, found.p_GI, color
    for k, (ax, axis) in enumerate(zip(axes[:, 0], "xyz", strict=True)):
        for words, (t, p, color) in paths.items():
            style = "--" if color == BEFORE else "-"
            ax.plot(t - log.t[0], p[:, k] - p[0, k], style, color=color, label=words)
        ax.set_ylabel(f"{axis} [m]")
    axes[-1, 0].set_xlabel("time [s]")
    legend_below(drawn, axes[0, 0], 3)
    return drawn


def _or_dash(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else "–"
