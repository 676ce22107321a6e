"""What is said of errors is what was put into them."""

import numpy as np
import pytest
from figure_numbers import assert_numbers_apart

from surefoot.models.calibration.error_statistics import error_statistics
from surefoot.scenarios.reporting.observer_errors import (
    bound_words,
    error_bounds,
    error_distributions,
    error_words,
)
from surefoot.scenarios.reporting.plotting import png

EPSILON = np.array([0.1, 0.1, 0.1])


@pytest.fixture(scope="module")
def errors():
    """Gaussian in training; elsewhere skewed and biased, heavy-tailed, and the same."""
    rng = np.random.default_rng(0)
    train = 0.03 * rng.standard_normal((6000, 3))
    test = 0.03 * rng.standard_normal((6000, 3))
    test[:, 0] = 0.02 * (rng.gamma(2.0, size=6000) - 1.0)
    test[:, 1] = 0.03 * rng.standard_t(3, size=6000)
    return train, test


def test_words_name_bias_skewness_and_tails(errors):
    of_train, of_test = error_statistics(errors[0], K=4), error_statistics(errors[1], K=4)
    forward, lateral, vertical, _ = error_words(of_train, of_test, "Stroll").split("\n\n")
    for sentence in (forward, lateral, vertical):
        assert "in training a Gaussian is not rejected" in sentence
    assert "on Stroll they are not Gaussian, skewed upwards" in forward
    assert "biased by +0.02" in forward.split("on Stroll")[1]
    assert "heavy tails" in lateral
    assert "on Stroll a Gaussian is not rejected" in vertical
    assert "spread 1.0 times" in vertical


@pytest.mark.parametrize(
    ("scale", "said"),
    [
        ((1.0, 1.0), "One bound holds for both"),
        ((1.0, 9.0), "is lost on the test"),
        ((9.0, 1.0), "not in training"),
        ((9.0, 9.0), "on neither"),
    ],
)
def test_words_say_where_the_bound_holds(errors, scale, said):
    train = errors[0]
    assert said in bound_words(scale[0] * train, scale[1] * train, EPSILON, 0.8)


def test_the_bounds_figure_shows_shares_of_the_data(errors):
    train, test = errors
    figure = error_bounds(train, test, EPSILON, 0.8)
    ax = figure.axes[0]
    share = 100 * (np.abs(test[:, 0]) <= EPSILON[0]).mean()
    assert f"test {share:.1f} %" in ax.get_title()
    assert png(figure)[:4] == b"\x89PNG"


def test_the_motivating_figure_fits_a_gaussian_to_each(errors):
    """The fit drawn over each axis' errors has their mean and their spread."""
    biased = errors[1] + np.array([0.04, -0.05, 0.06])
    figure = error_distributions(errors[0], biased, EPSILON, 0.8)
    for k, ax in enumerate(figure.axes[:3]):
        fits = [line for line in ax.get_lines() if "Gaussian fit" in str(line.get_label())]
        for line, e in zip(fits, (errors[0][:, k], biased[:, k]), strict=True):
            x, density = np.asarray(line.get_xydata()).T
            assert x[np.argmax(density)] == pytest.approx(e.mean(), abs=x[1] - x[0])
            assert density.max() == pytest.approx(1 / np.sqrt(2 * np.pi) / e.std(), rel=0.02)
        share = 100 * (np.abs(biased[:, k]) <= EPSILON[k]).mean()
        assert f"test {share:.1f} %" in ax.get_title()


@pytest.mark.parametrize("widest", [0.02, 0.0375, 0.06])
def test_numbers_below_the_errors_do_not_touch(errors, widest):
    largest = np.quantile(np.abs(errors[0]), 0.995, axis=0)
    train = errors[0] * widest / largest
    assert_numbers_apart(error_bounds(train, train, 0.5 * np.full(3, widest), 0.8))
