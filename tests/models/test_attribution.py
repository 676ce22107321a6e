"""Masks of stances, and what the bootstrap and a log's contacts say."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from known_evidence import BINS, NOISE, WIDTH, evidence

from surefoot.models.attribution.data import dead_contacts
from surefoot.models.attribution.weights import robust_weights, slips
from surefoot.models.bootstrap import block_bootstrap_counts
from surefoot.sim.log import Log, Meta


def test_a_slipping_stance_is_masked_and_a_systematic_error_is_not():
    one = evidence((0.01, 0, 0, 0))
    table = one.table.copy()
    standing = np.isfinite(table[:, 9])
    first = np.flatnonzero(standing)[60:72]
    table[first, 9] += 0.2
    masked = robust_weights(replace(one, table=table), NOISE).masked
    assert masked[first, 1].all()
    assert masked.sum() == len(first)
    brief = one.table.copy()
    brief[first[5:7], 9] += 0.05
    sliding = replace(one, table=brief)
    assert robust_weights(sliding, NOISE).masked[first, 1].all(), "a slide within a longer stance"
    biased = one.table.copy()
    biased[:, 9] += 0.2
    assert not robust_weights(replace(one, table=biased), NOISE).masked.any()


def test_a_stance_on_something_else_than_the_others_is_masked_by_its_height():
    one, rng = evidence(), np.random.default_rng(1)
    table = one.table.copy()
    standing = np.isfinite(table[:, 6:18:3])
    heights = one.layout.of("foot_height")
    table[:, heights] = np.where(standing, rng.normal(0.0, 1e-4, standing.shape), np.nan)
    first = np.flatnonzero(standing[:, 1])[:12]
    table[first, heights[1]] += 0.003
    assert not robust_weights(replace(one, table=one.table), NOISE).masked.any()
    masked = robust_weights(replace(one, table=table), NOISE).masked
    assert masked[first, 1].all()
    assert masked.sum() == len(first)
    uneven = table + 0.003 * np.sin(np.arange(BINS) // 12)[:, None] * (np.arange(WIDTH) >= 18)
    assert not robust_weights(replace(one, table=uneven), NOISE).masked.any()


def test_few_stances_are_no_bulk_to_stand_out_from():
    known = evidence()
    left = np.full_like(known.table, np.nan)
    left[:60] = known.table[:60]
    left[:12, 6] = 1.0
    assert not slips(known, left).any()


def test_the_block_bootstrap_has_the_spread_of_block_sums():
    sums = np.array([1.0, 5.0, 9.0])
    drawn = block_bootstrap_counts(3, np.random.default_rng(0), 4000) @ sums
    assert drawn.mean() == pytest.approx(15.0, rel=0.02)
    assert drawn.std() == pytest.approx(np.sqrt(3 * np.var(sums)), rel=0.05)


def test_wheels_that_never_lift_are_no_dead_contacts():
    t = 0.01 * np.arange(500)
    columns = {"t": t, "contact_left": 1.0 + 0.0 * t, "contact_right": 1.0 + 0.0 * t}
    columns |= {f"ref_p_{axis}": goes * t for axis, goes in (("x", 0.5), ("y", 0.0), ("z", 0.0))}
    columns |= {f"ref_q_{axis}": float(axis == "w") + 0.0 * t for axis in "wxyz"}
    for turns, dead in ((0.5, True), (8.0, False)):
        wheels = {f"q_{side}_wheel": turns * t / t[-1] for side in ("left", "right")}
        log = Log(pd.DataFrame(columns | wheels), Meta(100.0), "rolls")
        assert bool(dead_contacts(log)) == dead
