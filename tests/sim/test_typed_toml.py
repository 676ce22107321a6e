"""TOML as typed models: every fault is one line that names file, section and key."""

from contextlib import suppress
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from refusals import refusal, refused

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.toml import Count, Name, NonNegative, Positive, read_typed, typed


@dataclass(frozen=True)
class Leg:
    name: Name
    length: Positive = 0.3
    joints: tuple[str, ...] = ()
    shape: np.ndarray | None = None


@dataclass(frozen=True)
class Machine:
    weight: Positive
    size: tuple[float, float] = (1.0, 0.5)
    kind: Literal["walker", "arm"] | None = None
    motors: Count | None = None
    gains: float | dict[str, NonNegative] = 1.0
    leg: tuple[Leg, ...] = ()
    parts: dict[str, Leg] = field(default_factory=dict)

    def __post_init__(self):
        if self.kind == "arm" and self.leg:
            raise SurefootError("an arm has no leg")


GOOD = """
weight = 30
size = [0.6, 0.3]
kind = "walker"
motors = 2
gains = { knee = 20, hip = 30.5 }
[[leg]]
name = "left"
joints = ["hip", "knee"]
[[leg]]
name = "right"
length = 0.31
[parts.tail]
name = "tail"
"""


def test_a_good_file_is_what_it_says(tmp_path):
    (tmp_path / "m.toml").write_text(GOOD)
    assert read_typed(tmp_path / "m.toml", Machine) == Machine(
        weight=30.0,
        size=(0.6, 0.3),
        kind="walker",
        motors=2,
        gains={"knee": 20.0, "hip": 30.5},
        leg=(Leg("left", joints=("hip", "knee")), Leg("right", 0.31)),
        parts={"tail": Leg("tail")},
    )
    assert typed({"weight": 1}, Machine) == Machine(1.0)
    assert typed({"a": {"weight": 1}}, dict[str, Machine]) == {"a": Machine(1.0)}


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("weight = 30\n", "", ": weight is missing"),
        ("weight = 30", "weigth = 30", ": unknown key 'weigth'; known: weight, size, kind"),
        ("weight = 30", "weight = 0", ": weight must be a number > 0.0, is 0"),
        ("weight = 30", "weight = true", ": weight must be a number, is True"),
        ("weight = 30", "weight = inf", ": weight must be a number, is inf"),
        ("weight = 30", "weight = 2026-01-01", ": weight must be a number, is datetime"),
        ("motors = 2", "motors = 2.5", ": motors must be a whole number, is 2.5"),
        ("motors = 2", "motors = 0", ": motors must be a whole number >= 1, is 0"),
        ("0.3]", "0.3, 0.1]", ": size must be an array of length 2, is [0.6, 0.3, 0.1]"),
        ("0.3]", "nan]", ": size must be a number, is [0.6, nan]"),
        ('"walker"', '"boat"', ": kind must be one of walker, arm, is 'boat'"),
        ("knee = 20", "knee = -1", ": [gains] knee must be a number >= 0.0, is -1"),
        ("{ knee = 20, hip = 30.5 }", "'high'", ": gains must be a number or a table, is 'high'"),
        ("length", "lenght", ": [[leg]] 2 unknown key 'lenght'; known: name, length, joints"),
        ('name = "right"\n', "", ": [[leg]] 2 name is missing"),
        ('"left"', '""', ": [[leg]] 1 name must be a string of length >= 1, is ''"),
        ('"knee"]', "3]", ": [[leg]] 1 joints[1] must be a string, is 3"),
        ('name = "tail"', "", ": [parts.tail] name is missing"),
        ("[parts.tail]", "[[parts]]", ": parts must be a table, is [{'name': 'tail'}]"),
        ('"walker"', '"arm"', ": an arm has no leg"),
        (GOOD, "weight = 1\n[leg]\nname = 'a'", ": leg must be an array of tables, is {'name'"),
        ("weight", "= weight", ": not valid TOML"),
    ],
)
def test_a_fault_is_one_line_that_names_file_and_key(tmp_path, old, new, said):
    assert old in GOOD
    path = tmp_path / "m.toml"
    path.write_text(GOOD.replace(old, new, 1))
    assert refusal(read_typed, path, Machine, "machine").startswith(f"machine {path}{said}")


def test_a_file_that_is_not_there_is_named(tmp_path):
    refused(r"^machine .*no\.toml: No such", read_typed, tmp_path / "no.toml", Machine, "machine")


KEYS = ["weight", "size", "kind", "motors", "gains", "leg", "parts", "name", "length", "joints"]
VALUES = st.recursive(
    st.one_of(st.booleans(), st.integers(-3, 3), st.floats(), st.text(max_size=3), st.dates()),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(KEYS), inner),
    max_leaves=8,
)


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(table=st.dictionaries(st.sampled_from(KEYS), VALUES))
def test_any_tables_are_a_model_or_a_surefoot_error(table):
    with suppress(SurefootError):
        found = typed(table, Machine)
        assert found.weight > 0
        assert np.isfinite(found.size).all()
        assert all(isinstance(leg, Leg) and leg.name for leg in found.leg)
