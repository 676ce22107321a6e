"""Errors of an observer in training and elsewhere: statistics, description and figures."""

from collections.abc import Sequence

import numpy as np

from surefoot.models.calibration.error_statistics import AxisErrors, error_statistics
from surefoot.scenarios.reporting.figures import NAMED_AXES
from surefoot.scenarios.reporting.html import Picture, Section
from surefoot.scenarios.reporting.observer_figures import error_bounds, error_distributions
from surefoot.sim.common.errors import SurefootError

LEVEL = 0.01
"""Significance level at which normality is rejected."""


def error_section(
    train: np.ndarray, test: np.ndarray, epsilon: np.ndarray, gamma: float, where: str = "test"
) -> Section:
    """Section of a report on errors in training and on another log.

    It says so where either has too few independent errors.

    Args:
        train: (N, 3) [m/s] in I, stored with every observer: Observer.errors.
        test: (M, 3) [m/s] in I.
        epsilon: (3,) [m/s], the bounds.
        gamma: their joint level.
        where: name of the test log.
    """
    try:
        of_train, of_test = error_statistics(train), error_statistics(test)
    except SurefootError as error:  # too few to test, not too few to cover
        return Section("The observer's errors", str(error))
    rows = [*error_table(of_train, "training"), *error_table(of_test, where)]
    bound = bound_words(train, test, epsilon, gamma)
    words = f"{error_words(of_train, of_test, where)}\n\n{bound}"
    pictures = (
        Picture(
            error_distributions(train, test, epsilon, gamma),
            "Errors in training (green) and elsewhere (red), and the Gaussian fitted to each.",
        ),
        Picture(
            error_bounds(train, test, epsilon, gamma),
            "One bound for both: the share of errors that are smaller than the value below.",
        ),
    )
    return Section(f"The observer's errors: training and {where}", words, rows, pictures)


def error_table(found: Sequence[AxisErrors], where: str) -> list[dict[str, object]]:
    """One row per axis; p-values are of normality."""
    return [
        {
            "errors": where,
            "axis": word,
            "bias [m/s]": f"{e.mean:+.4f} ({e.interval[0]:+.4f} to {e.interval[1]:+.4f})",
            "std [m/s]": e.std,
            "skewness": e.skewness,
            "excess kurtosis": e.kurtosis,
            "beyond 3 std [%]": 100 * e.beyond,
            "p D'Agostino": e.normal_p,
            "p Anderson-Darling": e.anderson_p,
            "independent": e.thinned,
        }
        for (_, word), e in zip(NAMED_AXES, found, strict=True)
    ]


def error_words(
    train: Sequence[AxisErrors], test: Sequence[AxisErrors], where: str = "test"
) -> str:
    """Describe the statistics, in a sentence or two per axis."""
    sentences = []
    for (_, word), a, b in zip(NAMED_AXES, train, test, strict=True):
        sentences.append(
            f"{word.capitalize()}: in training {_shape(a)}; on {where} {_shape(b)}, and the errors "
            f"spread {b.std / a.std:.1f} times as far."
        )
    sentences.append(
        f"Shapes are tested at p < {LEVEL:g} on errors far enough apart to be independent, "
        f"{train[0].thinned} in training and {test[0].thinned} on {where}; with few of them a "
        "departure from a Gaussian may go undetected."
    )
    return "\n\n".join(sentences)


def bound_words(train: np.ndarray, test: np.ndarray, epsilon: np.ndarray, gamma: float) -> str:
    """Describe whether one bound holds on both."""
    inside = [100 * float((np.abs(e) <= epsilon).all(axis=1).mean()) for e in (train, test)]
    kept = [share >= 100 * gamma for share in inside]
    verdict = {
        (True, True): "One bound holds for both",
        (True, False): "The bound holds in training and is lost on the test",
        (False, True): "The bound holds on the test and not in training",
        (False, False): "The bound holds on neither",
    }[kept[0], kept[1]]
    x, y, z = epsilon
    return (
        f"{verdict}: |error| <= {x:.3f}, {y:.3f}, {z:.3f} m/s on all axes at once, meant for "
        f"{100 * gamma:g} %, holds for {inside[0]:.1f} % of the errors in training and "
        f"{inside[1]:.1f} % of the others."
    )


def _shape(e: AxisErrors) -> str:
    ways = []
    if e.skewness_p < LEVEL:
        side = "upwards" if e.skewness > 0 else "downwards"
        ways.append(f"skewed {side} (skewness {e.skewness:+.2f})")
    if e.kurtosis_p < LEVEL:
        tails = "heavy" if e.kurtosis > 0 else "light"
        ways.append(f"with {tails} tails (excess kurtosis {e.kurtosis:+.2f})")
    p = min(e.normal_p, e.anderson_p)
    if p < LEVEL:
        text = "they are not Gaussian" + (f", {' and '.join(ways)}" if ways else "")
    else:
        text = "a Gaussian is not rejected"
    low, high = e.interval
    biased = f"biased by {e.mean:+.3f} m/s ({low:+.3f} to {high:+.3f})"
    return f"{text} (p = {p:.2g}), {biased if low > 0 or high < 0 else 'without a bias'}"
