"""What reports and studies are written with: finished cases, tables, figures and pages.

Public, each name imported when it is first used. A study runs its cases in a `stage`, on
`processes`, and keeps each as a row (`finished_case`) until what determines it changes: the code,
and inputs such as the digest of a log. Its results are a `Section` each, with a table and pictures,
which `write_results` and `write_page` write; files and folders are written whole or not at all.
"""

# ruff: noqa: F401
from typing import TYPE_CHECKING

from surefoot.lazy import lazy_names

if TYPE_CHECKING:
    from surefoot.scenarios.cache import contents_digest, finished_case, read_case
    from surefoot.scenarios.reporting.html import Picture, Section
    from surefoot.scenarios.reporting.observer_errors import error_by_number
    from surefoot.scenarios.reporting.pages import origin_of, write_page, write_results
    from surefoot.scenarios.reporting.palette import (
        AFTER,
        BEFORE,
        BOUNDS,
        INK,
        OUTSIDE,
        TRUTH,
        estimator_color,
        estimator_look,
    )
    from surefoot.scenarios.reporting.plotting import (
        legend_below,
        new_figure,
        save_figure,
        set_title,
    )
    from surefoot.scenarios.reporting.tables import METRICS, to_csv, to_markdown
    from surefoot.scenarios.stages import percent_bar, processes, stage
    from surefoot.sim.common.files import file_digest, refuse_full, refuse_overwrite, whole_folder
    from surefoot.sim.common.progress import bar as progress_bar
    from surefoot.sim.common.sources import code_digest

__getattr__, __dir__ = lazy_names(globals())
