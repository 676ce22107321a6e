"""Settings of the Monte-Carlo study, from `montecarlo.toml`."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal, get_args

import numpy as np
from msgspec import Meta

from surefoot.estimator import InitialStd
from surefoot.extend import Count, Level, NonNegative, Positive, SurefootError, read_typed

MONTECARLO_PLAN = Path(__file__).with_name("montecarlo.toml")
Vector = tuple[float, float, float]
MixingLaw = Literal["gaussian", "student", "skewed", "bimodal", "outliers"]
MIXING_LAWS: tuple[str, ...] = get_args(MixingLaw)


@dataclass(frozen=True)
class TrotMotion:
    """A trotting quadruped's base: slow changes of speed and course, and the gait on top."""

    speed: float  # m/s
    speed_swing: float  # m/s
    speed_period: Positive  # s
    turn: float  # rad/s
    turn_swing: float  # rad/s
    turn_period: Positive  # s
    stride: Positive  # Hz
    bob: float  # m
    sway: float  # m
    surge: float  # m
    roll: float  # rad
    pitch: float  # rad


@dataclass(frozen=True)
class ImuErrors:
    """White-noise densities and fixed biases of the IMU."""

    gyro: Positive  # rad/s/sqrt(Hz)
    accel: Positive  # m/s^2/sqrt(Hz)
    bias_gyro: Vector  # rad/s
    bias_accel: Vector  # m/s^2


@dataclass(frozen=True)
class Noise:
    """Velocity errors of the unbiased regime: standard deviations of independent axes."""

    std: tuple[Positive, Positive, Positive]  # m/s


@dataclass(frozen=True)
class Component:
    """One component of the mixture that biased velocity errors are drawn from."""

    weight: NonNegative
    mean: Vector  # m/s
    covariance: tuple[Vector, Vector, Vector]  # m^2/s^2


@dataclass(frozen=True)
class ErrorLaw:
    """Law of the pseudo-measurement errors: a persistent part and a mixing part.

    bias scales the mean of the component that a trial draws; with bias 0 there are no components,
    and the mixing part has the covariance R_star. With drift [s], the persistent part is
    instead a Gauss-Markov process with this time constant and the components' second moment. mixing
    is one of MIXINGS. scale multiplies all of it.
    """

    bias: float = 0.0
    drift: float = 0.0
    mixing: str = "gaussian"
    scale: float = 1.0


@dataclass(frozen=True)
class Regime:
    """The law of the errors in the trials, and of those that the filters were calibrated on.

    `calibrated_mixing` and `calibrated_scale` are by default those of the trials. By default the
    calibration has the full bias and no drift.
    """

    name: str
    bias: float = 1.0
    drift: NonNegative = 0.0
    mixing: MixingLaw = "gaussian"
    scale: Positive = 1.0
    calibrated_bias: float = 1.0
    calibrated_drift: NonNegative = 0.0
    calibrated_mixing: MixingLaw | None = None
    calibrated_scale: Positive | None = None

    @property
    def test(self) -> ErrorLaw:
        """The law in the trials."""
        return ErrorLaw(self.bias, self.drift, self.mixing, self.scale)

    @property
    def calibration(self) -> ErrorLaw:
        """The law of the errors on which R, bounds and persistent part are calibrated."""
        return ErrorLaw(
            self.calibrated_bias,
            self.calibrated_drift,
            self.calibrated_mixing or self.mixing,
            self.calibrated_scale or self.scale,
        )


UNBIASED = Regime("unbiased", bias=0.0, calibrated_bias=0.0)
BIASED = Regime("biased")


@dataclass(frozen=True)
class Beyond:
    """Regimes beyond the paper's two: all four filters at one joint level."""

    gamma: Level
    trials: Count
    regime: tuple[Regime, ...]


@dataclass(frozen=True)
class MonteCarloStudy:
    """All settings of the study; rates in Hz, duration in s."""

    seed: Annotated[int, Meta(ge=0)]
    trials: Annotated[int, Meta(ge=2)]  # the tables give standard deviations
    duration: Positive
    imu_rate: Positive
    update_rate: Positive
    score_rate: Positive
    gammas: Annotated[tuple[Level, ...], Meta(min_length=1)]
    calibration_trials: Annotated[int, Meta(ge=5)]  # a covariance of three axes is estimated
    population: Annotated[int, Meta(ge=1000)]  # quantiles are taken of it
    motion: TrotMotion
    imu: ImuErrors
    prior: InitialStd
    noise: Noise
    component: tuple[Component, ...]
    beyond: Beyond

    def __post_init__(self):
        for name in ("update_rate", "score_rate"):
            ratio = self.imu_rate / getattr(self, name)
            if ratio < 1 or abs(ratio - round(ratio)) > 1e-9:
                raise SurefootError(f"{name} must divide imu_rate")
        try:
            assert self.factors.shape[1:] == (3, 3)
        except np.linalg.LinAlgError:
            raise SurefootError("[[component]] covariance must be positive definite") from None

    @cached_property
    def noise_std(self) -> np.ndarray:
        """Standard deviations (3,) [m/s] of the unbiased regime's errors."""
        return np.array(self.noise.std)

    @cached_property
    def weights(self) -> np.ndarray:
        """Weights (C,) of the mixture's components; they sum to 1."""
        weights = np.array([one.weight for one in self.component])
        return weights / weights.sum()

    @cached_property
    def means(self) -> np.ndarray:
        """Means (C, 3) [m/s] of the mixture's components, in I."""
        return np.array([one.mean for one in self.component])

    @cached_property
    def factors(self) -> np.ndarray:
        """Lower Cholesky factors (C, 3, 3) [m/s] of the components' covariances."""
        return np.linalg.cholesky(np.array([one.covariance for one in self.component]))

    @property
    def samples(self) -> int:
        """IMU samples of a trial after the initial one."""
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


def load_study(path: str | Path = MONTECARLO_PLAN) -> MonteCarloStudy:
    """The study of a file. Raises SurefootError, one line with file and key, where it is bad."""
    return read_typed(path, MonteCarloStudy)
