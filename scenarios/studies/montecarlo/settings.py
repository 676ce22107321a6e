"""What the Monte-Carlo study draws from: `montecarlo.toml`, schema-checked, as frozen data."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from surefoot.estimator.initial import InitialStd
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import bundled
from surefoot.sim.common.toml import read_toml

T = TypeVar("T")
BUNDLED = bundled("surefoot.scenarios.studies.montecarlo", "montecarlo.toml")
MIXINGS = ("gaussian", "student", "skewed", "bimodal", "outliers")


@dataclass(frozen=True)
class Motion:
    """A trotting quadruped's base: slow changes of speed and course, and the gait on top."""

    speed: float  # m/s
    speed_swing: float  # m/s
    speed_period: float  # s
    turn: float  # rad/s
    turn_swing: float  # rad/s
    turn_period: float  # s
    stride: float  # Hz
    bob: float  # m
    sway: float  # m
    surge: float  # m
    roll: float  # rad
    pitch: float  # rad


@dataclass(frozen=True)
class Imu:
    """White-noise densities and fixed biases of the IMU."""

    gyro: float  # rad/s/sqrt(Hz)
    accel: float  # m/s^2/sqrt(Hz)
    bias_gyro: np.ndarray  # (3,) rad/s
    bias_accel: np.ndarray  # (3,) m/s^2


@dataclass(frozen=True)
class Mixture:
    """A Gaussian mixture of velocity errors in I: weights (C,), means (C, 3), factors (C, 3, 3).

    factors are lower Cholesky factors of the components' covariances, in m/s.
    """

    weights: np.ndarray
    means: np.ndarray
    factors: np.ndarray


@dataclass(frozen=True)
class ErrorLaw:
    """How pseudo-measurement errors are made: a persistent part and a mixing part.

    bias scales the mean of the component that a trial draws; with bias 0 there are no components,
    and the mixing part has the covariance R_star. drift [s] makes the persistent part wander
    instead: a Gauss-Markov process with the components' second moment. mixing is one of MIXINGS.
    scale multiplies all of it.
    """

    bias: float = 0.0
    drift: float = 0.0
    mixing: str = "gaussian"
    scale: float = 1.0


@dataclass(frozen=True)
class Regime:
    """The law of the errors that are met, and of those that the filters were calibrated on."""

    name: str
    test: ErrorLaw
    calibration: ErrorLaw


UNBIASED = Regime("unbiased", ErrorLaw(), ErrorLaw())
BIASED = Regime("biased", ErrorLaw(bias=1.0), ErrorLaw(bias=1.0))


@dataclass(frozen=True)
class Study:
    """All that the study draws from; rates in Hz, duration in s, noise (3,) in m/s."""

    seed: int
    trials: int
    duration: float
    imu_rate: float
    update_rate: float
    score_rate: float
    gammas: tuple[float, ...]
    calibration_trials: int
    population: int
    motion: Motion
    imu: Imu
    prior: InitialStd
    noise: np.ndarray
    mixture: Mixture
    beyond_gamma: float
    beyond_trials: int
    beyond: tuple[Regime, ...]

    @property
    def samples(self) -> int:
        """IMU samples of a trial, after the one where the state stands."""
        return round(self.duration * self.imu_rate)

    @property
    def per_update(self) -> int:
        """IMU samples from one pseudo-measurement to the next."""
        return round(self.imu_rate / self.update_rate)

    @property
    def per_score(self) -> int:
        """IMU samples from one scored instant to the next."""
        return round(self.imu_rate / self.score_rate)

    @property
    def updates(self) -> int:
        """Pseudo-measurements of a trial."""
        return self.samples // self.per_update


def load_study(path: str | Path = BUNDLED) -> Study:
    """The study of a file. Raises SurefootError, one line with file and key, where it is bad."""
    path = Path(path)
    table = read_toml(path)
    try:
        study = _study(table)
    except SurefootError as error:
        raise SurefootError(f"{path}: {error}") from None
    except KeyError as error:
        raise SurefootError(f"{path}: {error} is missing") from None
    except (TypeError, ValueError, AttributeError, np.linalg.LinAlgError) as error:
        raise SurefootError(f"{path}: {error}") from None
    return study


def _study(table: dict[str, Any]) -> Study:
    beyond, components = table["beyond"], table["component"]
    known = {f.name for f in fields(Study)} - {"beyond_gamma", "beyond_trials", "mixture"}
    _refuse_unknown(table, known | {"component"}, "")
    _refuse_unknown(beyond, {"gamma", "trials", "regime"}, "beyond.")
    _refuse_unknown(table["noise"], {"std"}, "noise.")
    for component in components:
        _refuse_unknown(component, {"weight", "mean", "covariance"}, "component.")
    weights = np.array([c["weight"] for c in components], dtype=float)
    imu = dict(table["imu"])
    for name in ("bias_gyro", "bias_accel"):
        imu[name] = _vector(imu[name], name)
    study = Study(
        **{
            name: kind(table[name])
            for name, kind in {
                "seed": int, "trials": int, "duration": float, "imu_rate": float,
                "update_rate": float, "score_rate": float, "calibration_trials": int,
                "population": int,
            }.items()
        },
        gammas=tuple(float(g) for g in table["gammas"]),
        motion=_section(Motion, table["motion"], "motion"),
        imu=_section(Imu, imu, "imu"),
        prior=_section(InitialStd, table["prior"], "prior"),
        noise=_vector(table["noise"]["std"], "noise.std"),
        mixture=Mixture(
            weights / weights.sum(),
            np.array([_vector(c["mean"], "component.mean") for c in components]),
            np.linalg.cholesky(np.array([c["covariance"] for c in components], dtype=float)),
        ),
        beyond_gamma=float(beyond["gamma"]),
        beyond_trials=int(beyond["trials"]),
        beyond=tuple(_regime(r) for r in beyond["regime"]),
    )  # fmt: skip
    _check(study)
    return study


def _check(study: Study) -> None:
    for name in ("trials", "beyond_trials", "duration", "imu_rate", "update_rate", "score_rate"):
        if not 0 < getattr(study, name) < np.inf:
            raise SurefootError(f"{name} must be a number > 0")
    for name, rate in (("update_rate", study.update_rate), ("score_rate", study.score_rate)):
        ratio = study.imu_rate / rate
        if ratio < 1 or abs(ratio - round(ratio)) > 1e-9:
            raise SurefootError(f"{name} must divide imu_rate")
    if study.calibration_trials < 5:
        raise SurefootError("calibration_trials must be 5 or more: three axes are estimated")
    if study.population < 1000:
        raise SurefootError("population must be 1000 or more: quantiles are taken of it")
    if not study.gammas or not all(0 < g < 1 for g in (*study.gammas, study.beyond_gamma)):
        raise SurefootError("gammas must be inside (0, 1)")
    if not np.all(study.noise > 0) or not np.all(study.mixture.weights >= 0):
        raise SurefootError("noise.std must be > 0 and component weights >= 0")


def _regime(table: dict[str, Any]) -> Regime:
    """A regime of `beyond`: what is not said of the calibration is as in the test."""
    names = {f.name for f in fields(ErrorLaw)}
    _refuse_unknown(
        table, {"name"} | names | {f"calibrated_{n}" for n in names}, "beyond.regime."
    )  # fmt: skip
    values: dict[str, Any] = {"bias": 1.0} | {n: table[n] for n in names if n in table}
    # Half the bias, twice the bias: the calibration is still that of the full one.
    calibrated: dict[str, Any] = values | {"bias": 1.0, "drift": 0.0}
    calibrated |= {n: table[f"calibrated_{n}"] for n in names if f"calibrated_{n}" in table}
    for law in (values, calibrated):
        if law.get("mixing", MIXINGS[0]) not in MIXINGS:
            raise SurefootError(f"mixing '{law['mixing']}' is unknown: {' | '.join(MIXINGS)}")
    return Regime(str(table["name"]), ErrorLaw(**values), ErrorLaw(**calibrated))


def _section(kind: type[T], table: dict[str, Any], where: str) -> T:
    names = {f.name for f in fields(kind)}  # pyright: ignore
    _refuse_unknown(table, names, f"{where}.")
    missing = sorted(names - set(table))
    if missing:
        raise SurefootError(f"'{where}.{missing[0]}' is missing")
    return kind(**table)


def _refuse_unknown(table: dict[str, Any], known: set[str], where: str) -> None:
    unknown = sorted(set(table) - known)
    if unknown:
        raise SurefootError(f"unknown key '{where}{unknown[0]}'")


def _vector(value: Any, name: str) -> np.ndarray:
    out = np.array(value, dtype=float)
    if out.shape != (3,) or not np.isfinite(out).all():
        raise SurefootError(f"'{name}' must be three finite numbers")
    return out
