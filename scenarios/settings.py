"""Settings of the tasks: each is the argument of a function and the options of its command.

Nothing heavy is imported here, so that `--help` and a mistyped option are answered at once.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal


@dataclass(frozen=True, kw_only=True)
class OutputSettings:
    """What all tasks that write files have in common."""

    force: bool = False
    """Replace what an earlier run of this command wrote."""


@dataclass(frozen=True, kw_only=True)
class RobotSettings:
    """The robot of a log."""

    robot: str | None = None
    """Name of the robot, or its file (MJCF or URDF); by default the one named in the log."""


@dataclass(frozen=True, kw_only=True)
class CheckedSettings(RobotSettings):
    """How logs are checked for plausibility before they are used."""

    strict: bool = False
    """Stop with an error, instead of a warning, if a log contains implausible values."""


@dataclass(frozen=True, kw_only=True)
class ContactsSettings:
    """Whether sources of contacts are compared."""

    contacts: bool = False
    """Compare the leg filter with contacts as logged and from each other source that the log
    allows, and print lines for the import map that make the best ones; also done where contacts are
    implausible.
    """


@dataclass(frozen=True, kw_only=True)
class LearntSettings:
    """Files of observers and their bounds."""

    observer: tuple[Path, ...] = ()
    """Observer, a file from `train`; give one trained with loss mse, one with gml, or both."""
    bounds: tuple[Path, ...] = ()
    """Bounds (JSON), a file from `calibrate`, of an observer that is also given."""


@dataclass(frozen=True, kw_only=True)
class ChosenFilters:
    """Which filters run."""

    filters: tuple[str, ...] = ()
    """Filters to run, separated by commas; by default all that the inputs allow."""


@dataclass(frozen=True, kw_only=True)
class FilterFiles(CheckedSettings, LearntSettings, OutputSettings):
    """What filters run with, besides a log."""

    settings: Path | None = None
    """File of sensor noise, initial state and its standard deviations for the filters (TOML), such
    as `noise` writes.
    """
    set: tuple[str, ...] = ()
    """One setting as in the file of settings, which it overrides, such as noise.gyro=1e-3
    [rad/s/sqrt(Hz)].
    """
    effects: Path | None = None
    """File of effects (TOML) that the filters' model has, such as the effects.toml of `trace`."""
    start: Literal["reference", "rest", "moving"] | None = None
    """What the first state is taken from: the reference; gravity, of a robot at rest; or gravity
    and legs over the first second. By default the reference, or else what the first rows show.
    """

    @property
    def entries(self) -> tuple[str, ...]:
        """Lines that override those of the file of settings."""
        return self.set if self.start is None else (*self.set, f'start.kind="{self.start}"')


@dataclass(frozen=True)
class EstimateSettings(FilterFiles):
    """Estimate of one log, for `scenarios.estimate.file.estimate_file`."""

    log: Path
    """Log with IMU, and with what the filter needs besides."""
    filter: str
    """Name of the filter."""
    out: Path | None = None
    """File for the trajectory with covariances (.parquet); its poses are also written beside it as
    a .tum file.
    """
    no_advice: bool = False
    """Do not try what would mend an estimate that is not to be trusted, which may take several
    times as long as the estimate.
    """


@dataclass(frozen=True)
class CompareSettings(FilterFiles, ChosenFilters):
    """Comparison of filters on logs, for `scenarios.compare.compare_files`."""

    logs: tuple[Path, ...]
    """Logs to compare the filters on; errors are computed for those with a reference."""
    out: Path
    """Folder for table.csv, table.md, report.html, figures and recordings."""
    figures: Literal["png", "pdf", "svg"] = "png"
    """Kind of the files of the figures; the report has them as PNG."""


@dataclass(frozen=True)
class ScoreSettings(RobotSettings, OutputSettings):
    """Estimates to evaluate against a log's reference, for `scenarios.score.score`."""

    estimates: tuple[Path, ...]
    """Estimates: trajectories of `estimate` (.parquet), TUM text, or tables with columns t, p_x,
    q_w, ..., if known with covariances.
    """
    log: Path
    """Log with the reference."""
    out: Path
    """Folder for table.csv, table.md, report.html and figures."""
    frame: Literal["imu", "base"] = "imu"
    """Frame whose poses the estimates are: the IMU's, or the robot's base."""
    offset: float = 0.0
    """Added to the stamps of the estimates to put them on the log's clock [s]."""
    figures: Literal["png", "pdf", "svg"] = "png"
    """Kind of the files of the figures; the report has them as PNG."""


@dataclass(frozen=True)
class SimulateSettings(OutputSettings):
    """Walks to simulate, for `scenarios.datasets.simulate.simulate`."""

    scenarios: Sequence[str | Path]
    """Scenario files (TOML), or names of bundled ones."""
    out: Path
    """Folder for the logs."""
    robot: str | None = None
    """Name of the robot, or its file (MJCF or URDF); by default the scenario's own."""
    seeds: str = "0"
    """One seed, or a range such as 0:8, which is 0 to 7."""
    effects: Path | None = None
    """File of effects (TOML) to inject into the walks."""
    undeclared: bool = False
    """Omit the effects from the logs' metadata, so that no filter compensates them; truth.toml
    beside the logs lists them.
    """
    workers: int = 1
    """Number of parallel walks on this machine, one thread each."""
    cluster: str | None = None
    """Address of a Dask scheduler that runs the work, such as tcp://127.0.0.1:8786."""


@dataclass(frozen=True, kw_only=True)
class WalksSettings(RobotSettings):
    """Walks to train on, for `scenarios.training.many_walks.many_walks`.

    Each is of another robot of the kind. A sixth equal their model, a third are built within
    tolerances, and half have in addition the gait, sensors and effects measured on a real robot.
    """

    walks: int = 0
    """Number of walks to simulate and train on, instead of logs, on drawn courses (slopes, stairs,
    slippery ground, turns, payloads) or on the scenarios given; others are held out to stop by.
    Finished walks are kept in the cache folder.
    """
    walk_seed: int = 0
    """Seed of these walks."""
    workers: int = 0
    """Number of walks simulated at once; 0: one for each core."""


@dataclass(frozen=True)
class AlignSettings(OutputSettings):
    """Files of an alignment, for `scenarios.align.align_file`."""

    file: Path
    """A log, or with a map a recording, as read by `import`, of which all poses are used."""
    out: Path
    """Folder for alignment.json, alignment.png and aligned.parquet."""
    map: str | None = None
    """Map of the recording (TOML), or the name of a bundled one."""
    robot: str | None = None
    """Name of the robot, or its file (MJCF or URDF), in whose base frame the position is given as
    well.
    """
    most: float | None = None
    """Largest clock offset that is searched for, in either direction from that of the map [s]; by
    default as far as the recordings can have something in common.
    """


@dataclass(frozen=True, kw_only=True)
class TraceInputs(RobotSettings):
    """What a trace takes besides its logs."""

    declared: Path | None = None
    """File of effects (TOML, such as the effects.toml of an earlier trace) to include in the model,
    so that only what has changed since is found. Encoder zeros, sensor biases and the reference's
    clock are fitted to each log.
    """
    holdout: tuple[Path, ...] = ()
    """Further logs of the same robot, used by no fit, on which the result is checked."""


@dataclass(frozen=True)
class TraceSettings(TraceInputs, CheckedSettings, OutputSettings):
    """Files of a trace, for `scenarios.trace.run.trace_files`."""

    logs: tuple[Path, ...]
    """Logs of one robot, traced together."""
    out: Path
    """Folder for trace.json, effects.toml, report.html and the recording trace.rrd."""
    seed: int = 0
    """Seed of the bootstrap from which the intervals are computed."""


@dataclass(frozen=True, kw_only=True)
class WorkerSettings:
    """Parallel work."""

    workers: int = 1
    """Number of parallel processes on this machine."""


@dataclass(frozen=True)
class GridSettings(WorkerSettings):
    """How a grid is run and where to, for `scenarios.experiments.report.experiment`."""

    out: Path
    """Folder for tables, report.html and recordings."""
    seeds: str | None = None
    """One seed, or a range such as 0:8, which is 0 to 7; by default the file's (0 to 2 in a
    suite).
    """
    cache: Path | None = None
    """Folder of walks, observers, bounds and estimates, which later runs reuse; by default `cache`
    in the output.
    """
    no_recordings: bool = False
    """Write no rerun recordings of the sequences; by default there is one of each."""
    page: Path | None = None
    """Page of results to write as well, such as docs/results/suite_spot.md; its further tables are
    CSV files in docs/data/suite_spot.
    """
    data: Path | None = None
    """Folder of finished rows, one for each walk, which later runs reuse, such as
    docs/data/suite_spot; by default none are stored.
    """
    force: bool = False
    """Write tables and report again; what is in the cache is reused."""


@dataclass(frozen=True, kw_only=True)
class WalkSettings(OutputSettings):
    """Draws and page of a task that simulates the walks of a measured log."""

    seed: int = 0
    """Seed of the walks, of a training, and of the intervals."""
    page: Path | None = None
    """Page of results to write as well, such as docs/results/loop.md; its further tables are CSV
    files in docs/data/loop.
    """


@dataclass(frozen=True)
class LoopSettings(WalkSettings):
    """Outputs and seed of a loop, for `scenarios.trace.loop.loop`."""

    out: Path
    """Folder for all outputs; an interrupted run is resumed from it."""
    walks: int = 16
    """Number of walks to train on in each step; half as many are for the bounds. Finished ones are
    kept in the cache folder.
    """


@dataclass(frozen=True)
class RealismSettings(WalkSettings):
    """Outputs and seed of a comparison, for `scenarios.trace.realism.realism`."""

    out: Path
    """Folder for realism.json, realism.csv, drift.csv, table.md and report.html."""
    as_walked: bool = False
    """Also compare walks with the gait, sensors and effects measured on a real robot. Effects that
    are given replace the measured ones.
    """


@dataclass(frozen=True)
class TuneSettings(RobotSettings, WorkerSettings, ChosenFilters, OutputSettings):
    """A search of parameters, for `scenarios.tune.tune`."""

    out: Path
    """Folder for tuned.toml, tuned.md (errors before and after) and finished searches."""
    budget: int = 16
    """Number of runs of each filter over all logs of a robot."""
