"""One folder of good files of every kind, which each case gets a copy of."""

from pathlib import Path

import pytest
from good_files import good_files


@pytest.fixture(scope="session")
def good(tmp_path_factory) -> Path:
    return good_files(tmp_path_factory.mktemp("hostile") / "good")
