"""Fixtures that tests of several packages share."""

import pytest

from surefoot.sim.effects import CATALOGUE


@pytest.fixture
def catalogue():
    """The catalogue of effects, which a test may add to; afterwards it is as it was."""
    before = dict(CATALOGUE)
    yield CATALOGUE
    CATALOGUE.clear()
    CATALOGUE.update(before)
