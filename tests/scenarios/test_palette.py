"""Colours of estimators differ and can be read, with and without red-green blindness."""

import numpy as np
import pytest

from surefoot.scenarios.estimate.estimators import ESTIMATORS, shown_at_first, traits
from surefoot.scenarios.reporting.palette import AFTER, BEFORE, TEST, TRAIN, estimator_color, rgba

WHITE, VIEWER = 1.0, 0.005  # relative luminance of a page and of the viewer's background
SEEN = {
    "with": np.eye(3),
    "protan": [[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]],
    "deutan": [[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]],
}
"""How linear RGB is seen with colour vision and without (Machado et al. 2009, severity 1)."""
TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


def linear(color: str) -> np.ndarray:
    c = np.array(rgba(color)[:3]) / 255.0
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def lab(rgb: np.ndarray) -> np.ndarray:
    f = np.cbrt(TO_XYZ @ rgb.clip(0.0, 1.0) / [0.9505, 1.0, 1.089])
    return np.array([116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])])


@pytest.mark.parametrize("vision", SEEN)
def test_colours_differ(vision):
    """A difference of 10 is seen at a glance; those that are shown together differ by 30."""
    names = [name for name in ESTIMATORS if traits(name).drawn]
    first = shown_at_first(names)
    places = {name: lab(SEEN[vision] @ linear(estimator_color(name))) for name in names}
    for k, a in enumerate(names):
        for b in names[k + 1 :]:
            apart = np.linalg.norm(places[a] - places[b])
            assert apart > (30.0 if {a, b} <= set(first) else 10.0), (a, b, apart)


@pytest.mark.parametrize("vision", SEEN)
@pytest.mark.parametrize(
    "pair", [(TRAIN, TEST), (BEFORE, AFTER)], ids=["train_test", "before_after"]
)
def test_what_is_compared_differs(vision, pair):
    one, other = (lab(SEEN[vision] @ linear(color)) for color in pair)
    assert np.linalg.norm(one - other) > 30.0


@pytest.mark.parametrize("name", [name for name in ESTIMATORS if traits(name).color])
def test_a_line_stands_out_from_a_page_and_from_the_viewer(name):
    luminance = TO_XYZ[1] @ linear(estimator_color(name))
    assert (WHITE + 0.05) / (luminance + 0.05) > 1.9
    assert (luminance + 0.05) / (VIEWER + 0.05) > 2.3
