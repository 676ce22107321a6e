"""Whatever decides a result is part of what it is kept under: none comes back once that changed."""

import json
import sys
from dataclasses import replace
from importlib import import_module

import pytest
from courses import course_file
from own_package import PACKAGES
from refusals import refused

from studies import observers
from surefoot import Learnt, Robot, Scenario, simulate, walk
from surefoot.extend import Ground, Segment
from surefoot.models.registry import ARCHITECTURES, CALIBRATORS
from surefoot.models.residuals.channels import BUNDLED_CHANNELS
from surefoot.scenarios import tune
from surefoot.scenarios.cache import Product
from surefoot.scenarios.datasets import kept_walks
from surefoot.scenarios.datasets.index import recipe
from surefoot.scenarios.estimate.estimators import ESTIMATORS
from surefoot.scenarios.estimate.settings import read_tuned
from surefoot.scenarios.experiments import products
from surefoot.scenarios.experiments.file import Cell, Condition, Learning
from surefoot.scenarios.experiments.products import LearntFiles
from surefoot.scenarios.settings import LoopSettings, SimulateSettings, TuneSettings
from surefoot.scenarios.trace import loop
from surefoot.sim.common import sources
from surefoot.sim.common.sources import imported_sources, sources_digest
from surefoot.sim.effects import CATALOGUE
from surefoot.sim.walking.batch import Job, known_robot

WALK = Scenario("short", (Segment(1.0, 0.4),), Ground(0.8), "spot_class", stand=0.2)


def forget():
    """As another process would find things."""
    for one in (sources_digest, sources._contents, sources._folders, known_robot, read_tuned):
        one.cache_clear()


@pytest.fixture(autouse=True)
def fresh():
    forget()
    yield
    forget()


@pytest.fixture
def boots(tmp_path, monkeypatch):
    """A user's own effect in the catalogue, and the file that it is made of."""
    text = (PACKAGES / "own_effect" / "rubber_boots.py").read_text()
    path = tmp_path / "own_boots.py"
    path.write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    sys.modules.pop("own_boots", None)
    forget()
    kind = import_module("own_boots").RubberBoots
    monkeypatch.setitem(CATALOGUE.bundled, kind.name, kind)
    return kind("all", 0.004), path


@pytest.fixture
def machine(tmp_path):
    """A robot whose file includes another, and that other file."""
    part = tmp_path / "part.xml"
    part.write_text(Robot.load("spot_class").file.read_text())
    (tmp_path / "whole.xml").write_text('<mujoco><include file="part.xml"/></mujoco>')
    return str(tmp_path / "whole.xml"), part


def edited(path):
    """Change a source in a comment alone, a robot in one number."""
    text = path.read_text()
    path.write_text(
        text.replace('damping="', 'damping="1') if path.suffix == ".xml" else text + "x = 1\n"
    )
    assert path.read_text() != text
    forget()


@pytest.mark.parametrize(
    ("registry", "holder"),
    [
        (ESTIMATORS.bundled, "surefoot.scenarios.estimate.estimators"),
        (ARCHITECTURES.bundled, "surefoot.models.registry"),
        (CALIBRATORS.bundled, "surefoot.models.registry"),
        ({kind.name: kind for kind in BUNDLED_CHANNELS}, "surefoot.models.residuals.channels"),
        (CATALOGUE.bundled, "surefoot.sim.effects.catalogue"),
    ],
)
def test_every_member_of_a_registry_counts_where_it_is_named(registry, holder):
    found = imported_sources(holder)
    for name, member in registry.items():
        module = member.partition(":")[0] if isinstance(member, str) else member.__module__
        assert module in found, name


def test_a_walk_depends_on_what_its_robot_includes(machine):
    name, part = machine
    before = recipe(Job(WALK, name, 0))
    assert recipe(Job(WALK, name, 0)) == before
    edited(part)
    assert recipe(Job(WALK, name, 0)) != before


def test_a_walk_depends_on_the_code_of_simulation_and_of_its_effects(boots, monkeypatch):
    effect, path = boots
    job = Job(WALK, "spot_class", 0, (effect,))
    before, hidden = recipe(job), recipe(replace(job, declared=False))
    edited(path)
    assert recipe(job) != before
    assert recipe(replace(job, declared=False)) == hidden
    index = "surefoot.scenarios.datasets.index.sources_digest"
    monkeypatch.setattr(index, lambda module: "other code")
    assert recipe(Job(WALK, "spot_class", 0)) != hidden


def test_hidden_effects_of_other_code_are_refused(boots, tmp_path):
    path = boots[1]
    files = [course_file(tmp_path, 1.0)], tmp_path / "walks"
    (tmp_path / "effects.toml").write_text(
        '[[effect]]\nname = "rubber_boots"\ntarget = "all"\nvalue = 0.004\nunit = "m"\n'
    )

    def simulated():
        hidden = tmp_path / "effects.toml"
        return simulate(SimulateSettings(*files, effects=hidden, undeclared=True))

    assert simulated()[0].sha256 == simulated()[0].sha256
    edited(path)
    refused("other code of them", simulated)


class Found(Exception):
    """The inputs of the product that was asked for."""


@pytest.fixture
def keys(tmp_path, monkeypatch):
    """Product -> the inputs that it is kept under, for a walk of the robot with the effect."""

    def asked(folder, kind, inputs, code, suffix, make):
        raise Found(json.dumps(inputs))

    for module in (products, kept_walks):
        monkeypatch.setattr(module, "product", asked)

    def inputs_of(make, *arguments):
        with pytest.raises(Found) as found:
            make(tmp_path, *arguments)
        return found.value.args[0]

    def all_inputs(robot, effect):
        condition = Condition("one", effects=(effect,), declared=True)
        cell = Cell(WALK, robot, condition, 0)
        made = Product(tmp_path / "walk", "0", {"robot": robot, "declared": [effect.name]})
        other = Product(tmp_path / "other", "1", {})
        filters = LearntFiles({}, {}), ["leg"]
        return {
            "walk": inputs_of(products.make_walk, cell),
            "observer": inputs_of(products.make_observer, [("a", made)], Learning(), "mse", 0),
            "bounds": inputs_of(products.make_bounds, other, [("a", made)], 0.9, "conformal"),
            "estimate": inputs_of(products.make_estimates, made, "a", *filters, [0.9]),
            "recording": inputs_of(products.make_recording, made, cell, *filters, 0.9),
        }

    return all_inputs


@pytest.mark.parametrize("changed", ["effect", "robot"])
def test_every_product_depends_on_its_robot_and_the_code_of_its_effects(
    keys, boots, machine, changed
):
    effect, name = boots[0], machine[0]
    before = keys(name, effect)
    assert keys(name, effect) == before
    edited(boots[1] if changed == "effect" else machine[1])
    after = keys(name, effect)
    assert [kind for kind in before if after[kind] == before[kind]] == []


@pytest.mark.parametrize("changed", ["mounting", "parameter", "code"])
def test_estimates_and_recordings_depend_on_filters_and_what_they_are_tuned_to(
    keys, boots, tmp_path, monkeypatch, changed
):
    before = keys("spot_class", boots[0])
    first = ESTIMATORS["leg"]().parameters[0].name
    tunings = {"mounting": {"mounting": 0.5}, "parameter": {"filters": {"leg": {first: 0.123}}}}
    if changed == "code":
        monkeypatch.setattr(products, "estimator_code", lambda name: "other code")
    else:
        entry = replace(read_tuned()["default"], **tunings[changed])
        tune.write_tuned(tmp_path / "tuned.toml", {"default": entry})
        monkeypatch.setenv("SUREFOOT_TUNED", str(tmp_path / "tuned.toml"))
    after = keys("spot_class", boots[0])
    assert [kind for kind in before if after[kind] != before[kind]] == ["estimate", "recording"]


def test_a_search_depends_on_robot_and_effects(boots, machine, tmp_path, monkeypatch):
    effect, path = boots
    name, part = machine
    log = walk(WALK, Robot.load(name), 0, [effect])
    log.write(tmp_path / "log.parquet")
    asked = []
    monkeypatch.setattr(tune, "finished_case", lambda *given: asked.append(given[2]))
    for change in (None, path, part):
        if change:
            edited(change)
        settings = TuneSettings(tmp_path, robot=name, budget=1)
        tune.search_filter("leg", [tmp_path / "log.parquet"], settings, Learnt())
    assert asked[0] != asked[1] != asked[2] != asked[0]


def test_a_training_depends_on_the_walks_and_on_the_network(tmp_path, monkeypatch):
    asked = []

    def finished_case(folder, name, inputs, *_):
        asked.append(json.dumps(inputs))
        raise Found

    monkeypatch.setattr(observers, "finished_case", finished_case)
    for count, code in ((1, "one"), (1, "one"), (2, "one"), (1, "other")):
        monkeypatch.setattr(observers, "many_walks", lambda *_, count=count, **__: range(count))
        monkeypatch.setattr(observers, "code_digest", lambda *_, code=code: code)
        with pytest.raises(Found):
            observers.observer_study(observers.ObserverStudy(tmp_path, seeds=1))
    assert asked[0] == asked[1]
    assert len(set(asked)) == 3


def test_a_loop_depends_on_log_robot_and_code(boots, machine, tmp_path, monkeypatch):
    name, part = machine
    log = walk(WALK, Robot.load(name), 0)

    def stop(*_):
        raise Found

    monkeypatch.setattr(loop, "_traced", stop)

    def recipe_of(log):
        with pytest.raises(Found):
            loop.loop(log, Robot.load(name), LoopSettings(tmp_path / "loop", force=True))
        found = json.loads((tmp_path / "loop" / loop.RECIPE).read_text())
        with pytest.raises(Found):  # the same folder goes on
            loop.loop(log, Robot.load(name), LoopSettings(tmp_path / "loop"))
        return json.dumps(found)

    uneven = replace(log.meta, model={"ground_evenness": 0.01})
    others = replace(log, meta=uneven), replace(log, frame=log.frame.assign(gyro_x=0.0))
    found = [recipe_of(one) for one in (log, *others)]
    for path in (part, boots[1]):
        edited(path)
        found.append(recipe_of(log))
    assert len(set(found)) == 5
