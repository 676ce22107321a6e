"""What tests of this folder share: an arc that is drawn."""

import pytest
from arc_walk import Walk, make_walk


@pytest.fixture(scope="session")
def walk() -> Walk:
    return make_walk(seconds=4.0)
