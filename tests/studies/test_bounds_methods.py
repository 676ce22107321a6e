"""The methods of calibration that are plug-ins of a study: quantiles, joint levels, volumes."""

import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
from mapie_quantile import mapie_quantile

from studies.bounds import Bonferroni, Ellipsoid
from surefoot.models.calibration.calibrate import region_of
from surefoot.models.calibration.regions import Conformal, MaxNorm, Region, mahalanobis
from surefoot.models.registry import CALIBRATORS

PROJECT = Path(__file__).parents[2] / "studies" / "pyproject.toml"


def test_the_studies_offer_what_a_method_needs():
    offered = tomllib.loads(PROJECT.read_text())["project"]["entry-points"]["surefoot.calibrators"]
    assert not set(offered) & set(CALIBRATORS.bundled)
    for name, value in offered.items():
        method = EntryPoint(name, value, "surefoot.calibrators").load()
        assert all(hasattr(method, attribute) for attribute in CALIBRATORS.needs)


def test_quantiles_are_those_of_mapie():
    rng = np.random.default_rng(0)
    pilot, errors = rng.standard_t(4, (100, 3)), rng.standard_t(4, (150, 3)) * [1.0, 0.5, 2.0]
    box = region_of(Bonferroni(0.8), pilot, errors)
    theirs = [mapie_quantile(np.abs(axis), 1 - 0.2 / 3) for axis in errors.T]
    assert box.epsilon == pytest.approx(theirs, rel=1e-12)
    shape = pilot.T @ pilot / len(pilot)
    squared = mapie_quantile(mahalanobis(errors, shape), 0.8)
    found = region_of(Ellipsoid(0.8), pilot, errors)
    assert found.shape == pytest.approx(squared * shape, rel=1e-12)


def test_bonferroni_holds_however_axes_depend():
    """Also where one errs just when the others do not, for which gamma^(1/3) is too little."""
    rng, n, gamma = np.random.default_rng(5), 200_000, 0.8
    u = rng.uniform(size=n)
    laws = [
        rng.uniform(size=(n, 3)),
        np.column_stack([u] * 3),
        np.column_stack([(u + k / 3) % 1.0 for k in range(3)]),
    ]
    for errors in laws:
        found = region_of(Bonferroni(gamma), errors, errors[:5000])
        assert found.contains(errors[5000:]).mean() > gamma - 0.015


def test_an_ellipsoid_is_the_smaller_region_where_axes_err_together():
    rng = np.random.default_rng(6)
    L = np.linalg.cholesky(np.full((3, 3), 0.95) + 0.05 * np.eye(3))
    errors = rng.standard_normal((4000, 3)) @ L.T
    tight, maxnorm, conformal, bonferroni = (
        region_of(method(0.8), errors[:2000], errors[2000:])
        for method in (Ellipsoid, MaxNorm, Conformal, Bonferroni)
    )
    assert tight.volume < 0.5 * maxnorm.volume
    assert maxnorm.volume < conformal.volume < bonferroni.volume
    assert Region(tight.epsilon).contains(errors)[tight.contains(errors)].all()
