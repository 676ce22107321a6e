"""The bench compares like with like: the same work on both sides, the smallest times."""

import time
from dataclasses import replace

import pytest

from scenarios import bench_walking
from scenarios.bench import ITEMS, in_turn
from scenarios.cli import main
from sim.scenario import Scenario, Segment
from sim.terrain import Ground


@pytest.fixture(autouse=True)
def short_course(monkeypatch):
    monkeypatch.setattr(
        bench_walking, "COURSE", Scenario("bench", (Segment(0.5, 0.5),), Ground(0.8))
    )


def test_walk_and_replay_take_as_many_steps_to_the_same_bits():
    """`race` itself raises where a replay ends elsewhere."""
    pair = bench_walking.race(robots=3, threads=2)
    assert pair.steps == 3 * round(6.5 / 0.002)  # 3 s and twice 1 s of standing, 1 s at the end


def test_a_replay_that_ends_elsewhere_is_no_measure():
    bare = bench_walking.race(robots=1, threads=1).bare
    with pytest.raises(RuntimeError, match="differs"):
        replace(bare, last=bare.last + 1e-15).run()


def test_in_turn_tells_the_smallest_times():
    naps = iter([0.0, 0.05, 0.01, 0.05])
    ours, theirs = in_turn(lambda: time.sleep(next(naps)), lambda: None, rounds=3)
    assert 0.01 <= ours < 0.05
    assert theirs < 0.01


def test_the_command_prints_a_table(capsys):
    main("bench --only walking --rounds 1".split())
    assert "mujoco.rollout" in capsys.readouterr().out
    assert "walking" in ITEMS


def test_an_unknown_item_is_one_line(capsys):
    with pytest.raises(SystemExit, match="--only flying: known are"):
        main("bench --only flying".split())
