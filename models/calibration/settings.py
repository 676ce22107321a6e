"""Settings of a calibration, without importing torch."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class CalibrateSettings:
    """Level and method of bounds, for `surefoot.calibrate`."""

    gamma: float = 0.8
    """Joint level: probability that the velocity errors of all three axes are within the bounds."""
    method: str = "conformal"
    """Calibration method."""
    confidence: float = 0.95
    """Confidence of the bounds of the method `scenario`, over possible calibration walks."""
    K: int | None = None
    """Number of 10 ms steps between errors that are treated as independent; by default from the
    decay of their dependence.
    """


CALIBRATE_DEFAULT = CalibrateSettings()
