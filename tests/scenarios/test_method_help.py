"""`calibrate --help` has every method's own words, those that users add included."""

from surefoot.models.calibration.regions import MaxNorm
from surefoot.models.registry import CALIBRATORS
from surefoot.scenarios.cli.estimate import _labels


class Mine(MaxNorm):
    label = "my own statement"


def test_help_has_the_label_of_each_method(monkeypatch):
    monkeypatch.setitem(CALIBRATORS.bundled, "mine", Mine)
    words = _labels("conformal")
    assert "mine: my own statement" in words
    assert all(f"{name}: {kind.label}" in words for name, kind in CALIBRATORS.items())
    assert words.endswith("(default: conformal)")
