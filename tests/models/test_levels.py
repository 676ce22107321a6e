"""When a channel is at its floor, and when what was added to the model does harm to it."""

from dataclasses import replace

import numpy as np
import pytest

from surefoot.models.attribution.judgement import ChannelLevel, _by_chance, scatter_of_rms


@pytest.mark.parametrize(
    ("before", "after", "worse"),
    [
        (1.0, 0.9, False),
        (1.0, 1.01, False),  # hardly more
        (1.15, 1.21, False),  # less than the floor's walks differ by
        (1.0, 1.3, True),
        (0.5, 0.95, False),  # below what the declared model leaves
        (0.5, 1.3, True),
    ],
)
def test_harm_is_more_than_the_floors_walks_differ_by(before, after, worse):
    assert ChannelLevel(before, after, 1.0, "m", 1.2).worse == worse


def test_a_tenth_more_above_all_walks_is_harm_however_much_these_scatter():
    level = ChannelLevel(1.0, 1.12, 0.5, "m", 1.11)
    assert level.worse
    assert replace(level, by_chance=True).worse
    assert not replace(level, highest=1.13).worse
    assert not replace(level, after=1.09, highest=1.05).worse
    assert not replace(level, same_bins=(1.0, 1.05)).worse


def test_other_bins_are_no_harm():
    """Undone late touch-downs leave whole stances, of which the log as it is has few."""
    level = ChannelLevel(0.2, 1.1, 0.2, "mm", 0.4)
    assert level.worse
    assert not replace(level, same_bins=(0.2, 0.3)).worse
    assert replace(level, same_bins=(0.2, 0.9)).worse
    assert not replace(level, same_bins=(0.0, 0.0)).worse  # it has none of them


def test_without_a_floor_any_more_is_harm():
    assert ChannelLevel(1.0, 1.1, None, "m").worse
    assert not ChannelLevel(1.0, 1.0, None, "m").worse
    assert ChannelLevel(1.0, 1.1, None, "m").at_floor  # nothing says that it is not


def test_a_channel_is_at_its_floor_up_to_what_walks_reach():
    assert ChannelLevel(3.0, 1.2, 1.0, "m", 1.2).at_floor
    assert not ChannelLevel(3.0, 1.3, 1.0, "m", 1.2).at_floor
    assert ChannelLevel(3.0, 1.3, 1.0, "m", 1.2, low_share=0.9).at_floor


def test_the_level_of_a_few_values_scatters_as_drawn_ones_do():
    rng = np.random.default_rng(0)
    for values in (rng.normal(size=4000), rng.standard_t(6, size=4000)):
        drawn = np.sqrt(np.mean(rng.choice(values, (3000, 60)) ** 2, axis=1))
        assert scatter_of_rms(values**2, 60) == pytest.approx(drawn.std() / drawn.mean(), rel=0.1)


def test_a_few_events_are_worse_only_by_more_than_chance():
    rng = np.random.default_rng(1)
    before = rng.normal(size=(40, 2))
    one_off = before.copy()
    one_off[7, 0] = 5.0
    assert _by_chance(before, one_off)
    assert _by_chance(before, 0.9 * before)
    assert not _by_chance(before, 1.3 * before)
    assert _by_chance(np.full((3, 1), np.nan), np.ones((3, 1)))
