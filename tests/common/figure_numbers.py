"""Numbers below the axes of a figure, which must not run into one another."""

from itertools import pairwise

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


def assert_numbers_apart(figure: Figure) -> None:
    """Assert that each axes has two numbers or more below it, half a line's height apart."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    for ax in figure.axes:
        low, high = sorted(ax.get_xlim())
        labels = [
            label.get_window_extent(canvas.get_renderer())
            for place, label in zip(ax.get_xticks(), ax.get_xticklabels(), strict=True)
            if label.get_text() and low <= place <= high
        ]
        assert len(labels) >= 2
        for left, right in pairwise(sorted(labels, key=lambda box: box.x0)):
            assert right.x0 - left.x1 > 0.5 * left.height
