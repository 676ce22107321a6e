"""Advice on an estimate, and on where its contacts come from."""

from dataclasses import replace

import numpy as np
import pytest
from estimates import metrics_of
from recorded import as_recording
from synthetic import without

from surefoot import Learnt, Log, Robot, Scenario, import_log, run_filter, walk
from surefoot.extend import Ground, Segment
from surefoot.scenarios.cli.main import main
from surefoot.scenarios.estimate.advice import advice, likelihood, needs_advice
from surefoot.scenarios.estimate.contact_sources import (
    AS_LOGGED,
    ContactComparison,
    LogVariant,
    TriedContacts,
    chosen,
    compare_contacts,
    contact_lines,
    moving_in_contact,
)
from surefoot.scenarios.estimate.settings import (
    FilterSettings,
    NoiseSettings,
    StartSettings,
    StateSettings,
)
from surefoot.sim.importing.report import import_lines


@pytest.fixture(scope="module")
def walked() -> tuple[Log, Robot]:
    robot = Robot.load("spot_class")
    return walk(Scenario("advice", (Segment(3.0, 0.8, 0.0, 0.0),), Ground(0.8)), robot, 0), robot


def _advised(log: Log, robot: Robot, settings: FilterSettings) -> str:
    result = run_filter("leg", log, robot, settings=settings)
    assert needs_advice("leg", result.metrics, result.health)
    return advice("leg", log, robot, Learnt(), settings)


def test_a_good_estimate_needs_none(walked):
    log, robot = walked
    for some in (log, without(log, "ref_")):
        result = run_filter("leg", some, robot)
        assert not needs_advice("leg", result.metrics, result.health)


@pytest.mark.parametrize("cut", [("x_",), ("ref_",)], ids=["reference", "no reference"])
def test_contact_noise_that_is_too_small_is_sized_by_the_innovations(walked, cut):
    """Of feet that roll, while the filter takes them for points."""
    log, robot = walked
    log, robot = without(log, *cut), replace(robot, foot_radius=np.zeros(4))
    small = FilterSettings(noise=NoiseSettings(contact=2e-4, encoder=1e-4, kinematics=1e-4))
    said = _advised(log, robot, small)
    assert "filters.leg.contact=" in said
    value = float(said.partition("filters.leg.contact=")[2].partition(",")[0])
    mended = replace(small, filters={"leg": {"contact": value}})
    before, after = (run_filter("leg", log, robot, settings=s) for s in (small, mended))
    assert value > 4e-4
    assert likelihood(after.trajectory) > likelihood(before.trajectory)
    assert not after.health.lost


def test_contacts_that_come_late_are_found(walked):
    log, robot = walked
    names = [f"contact_{leg}" for leg in log.legs]
    rows = np.maximum(np.arange(len(log.t)) - round(0.04 * log.rate), 0)
    lagging = log.with_columns({name: log.frame[name].to_numpy()[rows] for name in names})
    said = _advised(lagging, robot, FilterSettings())
    assert "late = { contact = 0.04 }" in said


def test_contacts_of_a_dead_sensor_are_taken_from_another_quantity(walked):
    log, robot = walked
    dead = log.with_columns({"contact_FL": np.ones(len(log.t))})
    said = _advised(dead, robot, FilterSettings())
    assert 'of = "' in said
    assert "in [contact]" in said


def test_a_start_that_was_given_wrong_is_found(walked):
    log, robot = walked
    wrong = FilterSettings(start=StartSettings(b_g=1e-4), state=StateSettings(b_g=(0.05, 0.0, 0.0)))
    assert "of start and state" in _advised(log, robot, wrong)


def test_advice_that_mends_nothing_is_not_given_nor_is_a_slow_filter_tried_on(walked, monkeypatch):
    log, robot = walked
    lost = log.with_columns({"gyro_x": 0.5 * log.t})
    said = _advised(lost, robot, FilterSettings())
    assert "no single change" in said
    assert "not all" not in said
    monkeypatch.setattr("surefoot.scenarios.estimate.advice.PATIENCE", 0.0)
    assert "not all changes were tried" in _advised(lost, robot, FilterSettings())


def test_estimate_prints_it_and_the_imu_alone_is_not_silent(walked, tmp_path, capsys):
    log, _ = walked
    path = tmp_path / "walk.parquet"
    log.write(path)
    main(["estimate", str(path), "--filter", "leg"])
    shown = capsys.readouterr()
    assert "advice: " not in shown.err
    assert "no trajectory is kept" in shown.out
    main(["estimate", str(path), "--filter", "imu", "-o", str(tmp_path / "imu.parquet")])
    shown = capsys.readouterr()
    assert "advice: imu " in shown.err
    assert str(tmp_path / "imu.tum") in shown.out


ROBOTS = ("spot_class", "v60_class", "aliengo")
FAULTS = ("early", "late", "dead", "chattering")
"""Kinds of wrong contacts that are drawn; walks are shared."""


def widened(contact: np.ndarray, before: int, after: int) -> np.ndarray:
    """Contacts (N, L) that begin `before` rows earlier and end `after` rows later."""
    rows, found = np.arange(len(contact)), contact.copy()
    for shift in range(-after, before + 1):
        found |= contact[np.clip(rows + shift, 0, len(rows) - 1)]
    return found


def with_contacts(log: Log, contact: np.ndarray) -> Log:
    names = [f"contact_{leg}" for leg in log.legs]
    return log.with_columns(dict(zip(names, contact.T.astype(float), strict=True)))


def wrong_contacts(log: Log, fault: str, rng: np.random.Generator) -> Log:
    """Flags that begin 10 to 50 ms early, end so late, of one to three dead sensors, or that
    chatter at 3 to 15 % of the rows.
    """
    contact, rows = log.contact, round(rng.uniform(0.01, 0.05) * log.rate)
    if fault == "early":
        wrong = widened(contact, rows, 0)
    elif fault == "late":
        wrong = widened(contact, 0, rows)
    elif fault == "dead":
        wrong = contact.copy()
        wrong[:, rng.permutation(4)[: rng.integers(1, 4)]] = rng.integers(2)
    else:
        wrong = contact ^ (rng.random(contact.shape) < rng.uniform(0.03, 0.15))
    return with_contacts(log, wrong)


@pytest.fixture(scope="module")
def walks() -> dict[str, Log]:
    course = (Segment(7.0, 0.5), Segment(5.0, 0.4, turn=0.5), Segment(6.0, 0.5, turn=-0.4))
    scenario = Scenario("contacts", course, Ground(0.8))
    return {name: walk(scenario, Robot.load(name), 5) for name in ROBOTS}


def rpe(log: Log, robot: Robot) -> float:
    return metrics_of("leg", log, robot).rpe_trans


def judged(true: Log, wrong: Log, lacks: tuple[str, ...]) -> tuple[str, float, float, float]:
    """Of wrong contacts, the source that is found without a reference; the error of the leg filter
    with it, over the least of all sources and over that with true contacts; and the error with the
    wrong ones, over the same.
    """
    robot = Robot.for_log(true)
    found = compare_contacts(without(wrong, "ref_", *lacks), robot)
    assert found is not None
    errors = {
        one.contacts.source: rpe(with_contacts(true, one.contacts.log.contact), robot)
        for one in found.tried
    }
    source = AS_LOGGED if found.better is None else found.better.source
    least, by_true = min(errors.values()), rpe(true, robot)
    return source, errors[source] / least, errors[source] / by_true, errors[AS_LOGGED] / by_true


def drawn(true: Log, number: int) -> tuple[str, float, float, float]:
    """`judged` of wrong contacts that are drawn with a number."""
    wrong = wrong_contacts(true, FAULTS[number % len(FAULTS)], np.random.default_rng([5, number]))
    return judged(true, wrong, ("force_",) if number // 4 % 2 else ())


@pytest.mark.parametrize(
    "draws", [pytest.param(4, marks=pytest.mark.long), pytest.param(40, marks=pytest.mark.slow)]
)
def test_the_best_source_is_found_in_nine_of_ten_draws(walks, draws):
    """No source is then clearly better: by a quarter, or by the half from which another than the
    logged one is advised.
    """
    rows = [drawn(walks[ROBOTS[k % len(ROBOTS)]], k) for k in range(draws)]
    best = [over < (1.5 if source == AS_LOGGED else 1.25) for source, over, *_ in rows]
    assert np.mean(best) >= 0.9
    assert max(over_true for *_, over_true, _ in rows) <= 1.5


@pytest.mark.long
@pytest.mark.parametrize(("fault", "lacks"), list(zip(FAULTS, [(), ("force_",), ()], strict=False)))
def test_wrong_contacts_are_noticed_and_mended(walks, fault, lacks):
    wrong = wrong_contacts(walks["spot_class"], fault, np.random.default_rng(1))
    source, _, over_true, as_logged = judged(walks["spot_class"], wrong, lacks)
    assert source != AS_LOGGED
    assert over_true < 1.5 < 3.0 < as_logged


@pytest.mark.long
def test_true_contacts_are_left_as_they_are(walks):
    for log in (walks["v60_class"], without(walks["v60_class"], "ref_")):
        found = compare_contacts(log, Robot.for_log(log))
        assert found is not None
        assert found.better is None
        assert found.by_reference is log.has("reference")
        assert contact_lines(log, lambda share: None, only_better=True) == ((), {})


def test_a_log_without_contacts_is_told_where_to_take_them_from(walks):
    log = without(walks["v60_class"], "contact_")
    assert "surefoot info LOG --contacts" in "\n".join(import_lines(log))
    assert "contacts: none" not in "\n".join(import_lines(walks["v60_class"]))
    found = compare_contacts(log, Robot.for_log(log))
    assert found is not None
    assert found.logged is None
    assert found.better is not None


def test_of_contacts_about_as_good_those_that_stand_longest_are_taken(walks):
    """A few sure rows of each stance are enough for the leg filter, but not for a trace."""
    true = walks["v60_class"]
    found = run_filter("leg", true, Robot.for_log(true)).trajectory
    few = with_contacts(true, true.contact & (np.arange(len(true.t)) % 8 == 0)[:, None])
    whole, sure, wrong = (
        TriedContacts(LogVariant(source, {"contact": {}}, log), found, np.full(10, error**2))
        for source, log, error in (
            ("from force", true, 1.3),
            ("from gait", few, 1.0),
            ("from kinematics", with_contacts(true, true.contact | True), 8.0),
        )
    )
    assert chosen((sure, whole, wrong)) is whole
    assert ContactComparison((sure, whole, wrong), by_reference=True).better is whole.contacts


@pytest.mark.parametrize("lacks", ["gyro_", "q_"])
def test_a_log_on_which_no_leg_filter_runs_says_what_it_lacks(walks, lacks):
    (said,), changes = contact_lines(without(walks["v60_class"], lacks), lambda share: None)
    assert "not compared" in said
    assert lacks.rstrip("_") in said
    assert changes == {}


def test_feet_that_move_under_flags_are_timed():
    """Flags that begin 30 ms before a foot stands and end 10 ms after, and chatter between."""
    t = 0.01 * np.arange(200)
    stands = (np.arange(200) % 50 >= 20)[:, None]
    flags = widened(stands, 3, 1)
    flags[30::5] &= ~stands[30::5]
    begin, end = moving_in_contact(t, np.where(stands, 0.0, 1.0), flags)
    assert [begin, end] == pytest.approx([0.03, 0.01])


def test_info_prints_lines_of_a_map_that_mend_the_contacts(walks, tmp_path, capsys):
    """Of a dead sensor, which is implausible; pasted into a map, they make these contacts."""
    contact = walks["spot_class"].contact.copy()
    contact[:, 1] = True
    log = without(with_contacts(walks["spot_class"], contact), "ref_", "slip_", "mu_")
    log.write(tmp_path / "walk.parquet")
    main(["info", f"{tmp_path}/walk.parquet"])
    said = capsys.readouterr().out
    lines = said[said.index("\n[contact]\n") :]
    of_robot = f'[robot]\nname = "spot_class"\n{lines}'
    mended = import_log(*as_recording(tmp_path, without(log, "contact_"), more=of_robot))
    true, robot = walks["spot_class"], Robot.load("spot_class")
    assert rpe(with_contacts(true, mended.contact), robot) < 1.5 * rpe(true, robot)
