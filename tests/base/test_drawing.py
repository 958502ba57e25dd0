"""Drawings: axes, places of names, and marks as SVG and as PNG."""

import math
from xml.etree import ElementTree

import numpy as np
import pytest

from kinran.base.drawing import axes, names, plots
from kinran.base.drawing.canvas import Canvas


def test_values_stand_where_the_numbers_at_the_axis_say() -> None:
    axis = axes.logarithmic("µs", [0.5, 200])
    assert [value for value, _ in axis.ticks] == [1, 10, 100]
    assert axis.part(10) - axis.part(1) == pytest.approx(axis.part(100) - axis.part(10))
    assert 0 < axis.part(0.5) < axis.part(200) < 1
    assert (axis.part(0), axis.part(math.inf)) == (0, 1)
    axis = axes.linear("dB", [18.2, 33.0])
    assert [text for _, text in axis.ticks] == ["20", "25", "30"]
    assert axes.places("region", ["gold", "red"]).part(1) == 0.75


def test_axes_of_one_value_have_a_length() -> None:
    for make in (axes.logarithmic, axes.linear):
        axis = make("", [0.3])
        assert axis.part(0.3) == pytest.approx(0.5)
        assert axis.ticks


def test_a_name_stands_beside_its_dot_and_off_what_is_taken() -> None:
    inside = (0.0, 0.0, 400.0, 400.0)
    free = names.place("twill", (200, 200), [], inside)
    assert math.dist(((free[0] + free[2]) / 2, (free[1] + free[3]) / 2), (200, 200)) < 40
    moved = names.place("twill", (200, 200), [free], inside)
    assert names.covered(np.array([moved]), [free]).item() == 0
    cornered = names.place("twill", (398, 2), [], inside)
    assert cornered[0] >= 0
    assert cornered[1] >= 0
    assert cornered[2] <= 400


def test_marks_are_escaped() -> None:
    canvas = Canvas(20, 20)
    canvas.dot((5, 5), "#ff0000", 3, '<b> & "c"', series='"><script>')
    canvas.text((1, 9), "</svg>")
    root = ElementTree.fromstring(canvas.svg("a < b"))
    assert root.get("aria-label") == "a < b"
    assert [mark.get("data-series") for mark in root.iter() if mark.get("data-series")] == ['"><script>']
    assert [mark.text for mark in root.iter() if mark.text] == ['<b> & "c"', "</svg>"]


def test_picture_and_svg_show_the_same_marks() -> None:
    canvas = Canvas(40, 20)
    canvas.box((0, 0), (10, 20), "#ff0000")
    canvas.dot((25, 10), "#0000ff", 4, "")
    canvas.line([(30, 0), (30, 20)], "#00ff00", 2, dashed=True)
    picture = canvas.png(1)
    assert picture.shape == (20, 40, 3)
    np.testing.assert_array_equal(picture[10, 5], (255, 0, 0))
    np.testing.assert_array_equal(picture[10, 25], (0, 0, 255))
    green = (picture[:, 30] == (0, 255, 0)).all(1)
    assert green[[0, 4, 9, 13]].all()
    assert not green[[7, 16]].any()
    assert 'stroke-dasharray="5 4"' in canvas.svg("")


def test_bars_are_as_long_as_their_values() -> None:
    bars = [plots.Bar("mean", 1.0, "1 s"), plots.Bar("worst of all lights", 4.0, "4 s"), plots.Bar("none", 0.0, "0 s")]
    drawing = plots.bars([("first", bars), ("", [])], 400)
    lengths = [mark.points[1][0] - mark.points[0][0] for mark in drawing.marks if mark.kind == "box"]
    assert lengths[1] == pytest.approx(4 * lengths[0])
    assert lengths[2] == 1
    assert all(0 <= x <= 400 and 0 <= y <= drawing.height for mark in drawing.marks for x, y in mark.points)
