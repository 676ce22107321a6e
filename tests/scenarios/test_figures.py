"""Figures show the numbers they are given, with units, and are the same twice."""

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from refusals import refused

from surefoot.estimator.evaluation.trajectory import reference
from surefoot.models.attribution.judgement import ChannelLevel
from surefoot.models.calibration.mixing import mixing
from surefoot.models.residuals.channels import channels
from surefoot.scenarios.estimate.error_series import error_series
from surefoot.scenarios.estimate.estimators import ESTIMATORS
from surefoot.scenarios.experiments.figures import by_sequence, errors_figure, paths
from surefoot.scenarios.reporting import figures, observer_errors
from surefoot.scenarios.reporting.palette import estimator_color, estimator_line
from surefoot.scenarios.reporting.plotting import png, save_figure
from surefoot.scenarios.trace.report import over_floor


def words(figure: Figure) -> str:
    """All text of a figure, legends included."""
    found = [t.get_text() for ax in figure.axes for t in ax.texts]
    found += [ax.get_title(loc="left") for ax in figure.axes]
    found += [label for ax in figure.axes for label in (ax.get_xlabel(), ax.get_ylabel())]
    found += [t.get_text() for legend in figure.legends for t in legend.get_texts()]
    found += [figure.get_suptitle()]
    return "\n".join(found)


@pytest.fixture(scope="module")
def errors(walk):
    truth = reference(walk.log)
    return {name: error_series(truth, t) for name, t in walk.trajectories.items()}


@pytest.fixture(scope="module")
def drawn(walk, errors) -> dict[str, Figure]:
    return {
        "trajectories": figures.trajectories(walk.log, errors),
        "height": figures.height_figure(walk.log, errors),
        "axes": figures.errors_by_axis(errors),
    }


def test_no_legend_is_cut_off_where_every_estimator_is_drawn(walk, errors):
    all_of_them: dict[str, Any] = dict.fromkeys(ESTIMATORS, errors["leg"])
    for figure in (
        figures.position_error(all_of_them),
        figures.height_figure(walk.log, all_of_them),
        figures.trajectories(walk.log, all_of_them),
    ):
        png(figure)
        (legend,) = figure.legends
        whole, box = figure.bbox, legend.get_window_extent()
        assert whole.x0 <= box.x0
        assert box.x1 <= whole.x1
        assert whole.y0 <= box.y0


@pytest.mark.parametrize("path", [(4.0, 4.0), (20.0, 2.0), (2.0, 20.0)])
def test_a_path_of_any_shape_leaves_room_for_title_and_legend(path):
    ends = np.linspace(0.0, 1.0, 9)[:, None] * (*path, 0.0)
    log: Any = SimpleNamespace(ref_p=ends, meta=SimpleNamespace(seed=0, model={}))
    estimate: Any = SimpleNamespace(p_GI=ends + 0.1, distance=np.full(9, 0.2))
    figure = figures.trajectories(log, {"leg": estimate, "coverage": estimate})
    png(figure)
    (ax,), (legend,) = figure.axes, figure.legends
    with_title = ax.get_tightbbox()
    assert with_title is not None
    assert with_title.y1 <= figure.bbox.y1
    assert legend.get_window_extent().y1 <= ax.xaxis.label.get_window_extent().y0
    (low, high), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    assert low <= 0.0 <= path[0] <= high
    assert bottom <= 0.0 <= path[1] <= top


def test_residuals_stand_over_the_floor_and_what_is_not_judged_is_hollow():
    floor = {"noise_floor": 0.1, "unit": "m/s^2", "of_noise": 0.1}
    levels = {
        "imu_accel": ChannelLevel(0.4, 0.1, **floor),
        "leg_velocity": ChannelLevel(0.4, 0.2, **floor),
        "stance_velocity": ChannelLevel(0.4, 0.2, **floor, evaluation_only=True),
    }
    (ax,) = over_floor(levels).axes
    dots = [one for one in ax.collections if np.size(one.get_offsets())]  # the legend's have none
    places = np.array([np.asarray(one.get_offsets())[0] for one in dots]).reshape(3, 2, 2)
    assert places[..., 0] == pytest.approx(np.array([[4.0, 1.0], [4.0, 2.0], [4.0, 2.0]]))
    filled = [to_hex(np.asarray(one.get_facecolor())[0]) != "#ffffff" for one in dots[::2]]
    assert filled == [True, True, False]
    colors = [to_hex(str(one.get_color())) for one in ax.texts]
    assert colors[0] == colors[2] != colors[1]  # in red only what is above its floor


@pytest.mark.parametrize("sigma", [0.01, 0.1, 0.5, 2.0])
def test_three_sigma_is_shown_whole_or_said_to_be_cut_off(sigma):
    part = pd.DataFrame({"t": [0.0, 1.0], "distance": [0.0, 0.1], "sigma": [0.0, sigma]})
    figure = errors_figure({"walk": {"leg": part}}, "Errors")
    top = figure.axes[0].get_ylim()[1]
    assert 0.1 < top <= 0.6 + 1e-9
    assert (top >= 3.0 * sigma) != (f"3σ up to {3.0 * sigma:g} m" in words(figure))


def test_the_height_panel_fits_the_estimates_but_those_that_are_lost():
    z = np.linspace(0.0, 1.0, 50)
    part = pd.DataFrame({"t": z, "ref_x": z, "ref_y": z, "ref_z": 0.3, "p_x": z, "p_y": z})
    series = {
        name: part.assign(p_z=0.3 - far * z)
        for name, far in (("leg", 0.05), ("coverage", 0.2), ("imu", 40.0))
    }
    low, high = paths(series, "A walk").axes[1].get_ylim()
    assert 0.05 < low < 0.1
    assert 0.3 < high < 0.35


def test_heights_and_paths_are_those_of_the_walk(drawn, walk, errors):
    lines = {str(line.get_label()).split(" (")[0]: line for line in drawn["height"].axes[0].lines}
    np.testing.assert_allclose(lines["Reference"].get_ydata(), walk.log.ref_p[:, 2])
    np.testing.assert_allclose(lines["leg"].get_ydata(), errors["leg"].p_GI[:, 2])
    assert "leg (+0.080 m at the end)" in words(drawn["height"])


def test_errors_by_axis_are_those_of_the_series(drawn, errors):
    panels = np.array(drawn["axes"].axes).reshape(3, 3)
    for column, (field, factor) in enumerate(
        (("position", 1.0), ("attitude", 180.0 / np.pi), ("velocity", 1.0))
    ):
        for axis in range(3):
            lines = {line.get_label(): line for line in panels[axis, column].lines}
            error, sigma = (getattr(errors["leg"], name) for name in (field, f"{field}_sigma"))
            np.testing.assert_allclose(lines["leg"].get_ydata(), factor * error[:, axis])
            edges = [line.get_ydata() for line in panels[axis, column].lines]
            upper = 3.0 * factor * sigma[:, axis]
            assert any(np.allclose(edge, upper) for edge in edges)


def test_a_figure_counts_from_a_whole_second_of_an_epoch(errors):
    of_epoch = {name: replace(one, t=one.t + 1.7e9) for name, one in errors.items()}
    figure = figures.position_error(of_epoch)
    png(figure)
    (ax,) = figure.axes
    assert "1700000000" in ax.get_xlabel()
    shown = [text.get_text() for text in ax.get_xticklabels()]
    assert shown
    assert not ax.xaxis.get_offset_text().get_text()
    assert all(abs(float(text.replace("−", "-"))) < 1000.0 for text in shown)


@pytest.mark.parametrize("kind", ["pdf", "svg", "png"])
def test_a_figure_is_the_same_twice_and_replaces_no_file(errors, drawn, tmp_path, kind):
    one, two = (tmp_path / f"{name}.{kind}" for name in ("one", "two"))
    for path in (one, two):
        save_figure(figures.errors_by_axis(errors), path)
    assert one.read_bytes() == two.read_bytes()
    refused("exists already", save_figure, drawn["axes"], one)


def test_a_channel_without_a_floor_and_a_walk_without_estimates_still_draw(walk):
    level = ChannelLevel(0.3, 0.1, None, "rad")
    assert png(over_floor(dict.fromkeys(list(channels())[:6], level)))
    assert png(over_floor({}))
    assert png(figures.trajectories(walk.log, {}))
    assert png(figures.position_error({}))


def test_the_mixing_figure_shows_the_curve_and_where_k_was_read_from_it():
    x = np.cumsum(np.random.default_rng(2).normal(size=(3000, 3)), axis=0) % 7.0
    curve = mixing(x)
    ax = observer_errors.mixing_curve(curve).axes[0]
    lines = {str(line.get_label()): np.asarray(line.get_xydata()) for line in ax.get_lines()}
    drawn = [line for line in lines.values() if len(line) == len(curve.lags)]
    for k in range(3):
        np.testing.assert_array_equal(drawn[2 * k][:, 1], curve.beta[:, k])
        np.testing.assert_array_equal(drawn[2 * k + 1][:, 1], curve.excess[:, k])
    (at,) = [line for label, line in lines.items() if label.startswith("K = ")]
    assert at[0, 0] == curve.K


def test_paths_are_those_of_the_estimates():
    rng = np.random.default_rng(3)
    names = ["t", "ref_x", "ref_y", "ref_z", "p_x", "p_y", "p_z"]
    series = {
        name: pd.DataFrame(rng.normal(size=(50, 7)), columns=names) for name in ("coverage", "leg")
    }
    above, height = paths(series, "Two walks").axes[:2]
    for k, name in enumerate(series):
        np.testing.assert_array_equal(above.get_lines()[k + 1].get_xdata(), series[name]["p_x"])
        np.testing.assert_array_equal(above.get_lines()[k + 1].get_ydata(), series[name]["p_y"])
        np.testing.assert_array_equal(height.get_lines()[k + 1].get_ydata(), series[name]["p_z"])
    truth = series["coverage"]
    np.testing.assert_array_equal(above.get_lines()[0].get_xdata(), truth["ref_x"])
    np.testing.assert_array_equal(above.get_lines()[0].get_ydata(), truth["ref_y"])


@pytest.mark.parametrize("most", [0.1, 0.3, 3.0, 3000.0])
def test_numbers_of_a_logarithmic_axis_have_room(most):
    rows = [
        {"sequence": name, "role": role, "condition": condition, "filter": "leg", "APE": size}
        for name, role in (("there", "test"), ("back", "train"))
        for condition in ("as drawn", "as built", "as walked")
        for size in (0.04, most)
    ]
    drawn = by_sequence(pd.DataFrame(rows), "APE", "errors")
    drawn.canvas.draw()
    for ax in drawn.axes:
        low, high = ax.get_xlim()
        labels = [x for x in ax.get_xticklabels(which="both") if low <= x.get_position()[0] <= high]
        boxes = sorted(tuple(x.get_window_extent().intervalx) for x in labels if x.get_text())
        assert len(boxes) >= 2
        assert all(left[1] < right[0] for left, right in pairwise(boxes))


def test_two_worlds_of_one_estimator_share_its_colour_and_differ_in_line():
    shown = [f"{name} {side}" for name in ("leg", "coverage") for side in ("before", "after")]
    assert [estimator_color(name) for name in shown[::2]] == [
        estimator_color(name) for name in ("leg", "coverage")
    ]
    assert len({(estimator_color(name), estimator_line(name)) for name in shown}) == 4


def test_a_filter_that_a_condition_lacks_leaves_its_panel_without_its_dots():
    row = {"sequence": "loop", "role": "test", "condition": "as drawn", "filter": "leg", "APE": 0.1}
    rows = [row, row | {"filter": "coverage"}, row | {"condition": "as walked"}]
    drawn, walked = by_sequence(pd.DataFrame(rows), "APE", "errors").axes
    dots = [[len(np.asarray(line.get_xdata())) for line in ax.lines] for ax in (drawn, walked)]
    assert dots[0] == [1, 1, 1, 1]  # each filter's seeds, and their mean
    assert sorted(dots[1]) == [0, 0, 1, 1]
