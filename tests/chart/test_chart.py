"""From the rows of an experiment to front, table, drawing and page."""

import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from trials import shiny_trial

from kinran import canvas
from kinran.chart import experiments, figure, front, meter, page, rows
from kinran.chart.methods import methods
from kinran.chart.rows import Row
from kinran.files import InputError


def row(method: str, family: str, microseconds: float, size: float, error: float) -> Row:
    values = {"microseconds": microseconds, "bytes": size, "relative_error": error, "psnr_display": 30.0}
    return Row("cloth", "all", "", method, family, 100, values)


FLOOR = Row("cloth", "floor", "", "read", "floor", 100, {"microseconds": 0.5})


def test_a_method_beats_another_when_nowhere_worse_and_clearly_better_somewhere() -> None:
    assert front.beats((1, 10, 0.1), (10, 10, 0.1))
    assert front.beats((1, 10, 0.1), (1, 10, 0.2))
    assert not front.beats((1, 10, 0.1), (1, 10, 0.1))
    assert not front.beats((1, 10, 0.1), (10, 1, 0.1))
    assert not front.beats((1.1, 10, 0.1), (1.3, 10, 0.101))  # as good as equal
    assert not front.beats((1, 10, 0.2), (1000, 1000, 0.1))


def test_front_line_falls() -> None:
    points = [(3.0, 0.2), (1.0, 0.5), (2.0, 0.6), (4.0, 0.3), (5.0, 0.1)]
    assert front.line(points) == [(1.0, 0.5), (3.0, 0.2), (5.0, 0.1)]


def test_verdict_says_where_the_default_stands_and_what_beats_it() -> None:
    default = row("default (slope)", "default", 10, 28, 0.1)
    good = [FLOOR, default, row("PTM", "baseline", 1, 36, 0.8), row("kept", "baseline", 0, 5000, 0.07)]
    (sentence,) = front.verdict(good)
    assert "20 times the floor" in sentence
    assert "1 of 2 other methods are more accurate" in sentence
    assert "It is on the front" in sentence
    (sentence,) = front.verdict([*good, row("better", "kinran", 1, 28, 0.05)])
    assert "not on the front: better" in sentence


def test_photographs_are_judged_by_what_is_seen() -> None:
    floor = Row("cloth", "floor", "psnr_display", "read", "floor", 100, {"microseconds": 0.5})
    default, other = row("default (slope)", "default", 10, 28, 0.1), row("PTM", "baseline", 1, 20, 0.05)
    default.values["psnr_display"], other.values["psnr_display"] = 36.0, 30.0
    assert "It is on the front" in front.verdict([floor, default, other])[0]
    assert "36.0 dB" in front.verdict([floor, default, other])[0]
    assert "not on the front: PTM" in front.verdict([FLOOR, default, other])[0]


def test_table_round_trip(tmp_path: Path) -> None:
    table = [FLOOR, row("a, b", "paper", 1.5, 36, 0.125), Row("cloth", "theta", "0–30°", "PTM", "baseline", 9, {})]
    rows.write(tmp_path / "chart.csv", table)
    back = rows.read(tmp_path / "chart.csv")
    assert back == table
    assert math.isnan(back[2]["psnr_display"])
    (tmp_path / "other.csv").write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match="no table of a chart"):
        rows.read(tmp_path / "other.csv")
    with pytest.raises(InputError, match="no table of a chart"):
        rows.read(tmp_path / "missing.csv")


@pytest.fixture(scope="module")
def table() -> list[Row]:
    """All experiments on the small trial, with a default that is 10 % too bright."""
    tried = shiny_trial()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(experiments, "methods", lambda: [m for m in methods() if m.family != "kinran"])
        patch.setattr(meter, "bandwidth", lambda: 1e10)
        default = ("default <slope>", tried.truth * np.float32(1.1), {"microseconds": 5.0, "bytes": 28.0})
        return experiments.run(tried, "cloth", ["gold", "red"], default)


def test_experiments_cover_what_the_chart_draws(table: list[Row]) -> None:
    found = {name: [r for r in table if r.experiment == name] for name in {r.experiment for r in table}}
    assert set(found) == {"floor", "all", "theta", "region", "directions", "exposures", "extrapolation"}
    assert [r.setting for r in found["directions"] if r.method == "PTM"] == ["45", "30", "16"]
    assert [r.setting for r in found["exposures"] if r.method == "PTM"] == ["3", "2"]
    assert {r.setting for r in found["region"]} == {"gold", "red"}
    assert next(r for r in found["all"] if r.family == "default")["relative_error"] == pytest.approx(0.1, rel=1e-4)
    assert all(r.lights == 45 for r in found["all"])
    assert found["floor"][0]["microseconds"] == pytest.approx(1e6 * 45 * 12 / 1e10)


def test_fewer_exposures_and_lights_are_worse_for_interpolation(table: list[Row]) -> None:
    for experiment, order in (("exposures", ("3", "2")), ("directions", ("45", "16"))):
        own = {r.setting: r["relative_error"] for r in table if r.experiment == experiment and r.method == "Delaunay"}
        assert own[order[0]] < own[order[1]]


def test_extrapolation_is_worse_than_interpolation(table: list[Row]) -> None:
    own = {(r.experiment, r.setting): r["relative_error"] for r in table if r.method == "PTM" and r.setting == "65–90°"}
    assert own["extrapolation", "65–90°"] > own["theta", "65–90°"]


def test_drawing_is_well_formed_and_escaped(table: list[Row], tmp_path: Path) -> None:
    drawing = figure.draw(table)
    canvas.write(tmp_path / "chart.svg", drawing)
    canvas.write(tmp_path / "chart.png", drawing)
    text = (tmp_path / "chart.svg").read_text(encoding="utf-8")
    root = ElementTree.fromstring(text)
    marks = {mark.get("data-series") for mark in root.iter() if mark.get("data-series")}
    assert {r.method for r in table if r.experiment == "all"} <= marks
    assert "default <slope>" not in text
    assert drawing.png(1).shape == (drawing.height, drawing.width, 3)
    for mark in drawing.marks:
        for x, y in mark.points:
            assert -1 <= x <= drawing.width + 1
            assert -1 <= y <= drawing.height + 1


def test_exploded_errors_are_drawn_at_the_edge() -> None:
    table = [FLOOR, row("default (slope)", "default", 10, 28, 0.1), row("PTM", "baseline", 1, 36, 0.8)]
    for setting, value in (("100", 0.1), ("30", 2000.0), ("16", math.inf)):
        table.append(Row("cloth", "directions", setting, "PTM", "baseline", 16, {"relative_error": value}))
    drawing = figure.draw(table)
    assert all(math.isfinite(v) for mark in drawing.marks for point in mark.points for v in point)


def test_page_holds_the_charts_of_all_fabrics(table: list[Row], tmp_path: Path) -> None:
    import argparse

    rows.write(tmp_path / "a.csv", table)
    rows.write(tmp_path / "b.csv", [FLOOR, row("default (slope)", "default", 10, 28, 0.1)])
    page.main(argparse.Namespace(charts=[tmp_path / "a.csv", tmp_path / "b.csv"], out=tmp_path / "chart.html"))
    text = (tmp_path / "chart.html").read_text(encoding="utf-8")
    assert text.count("<section>") == text.count("<svg") == 2
    assert "default <slope>" not in text
    assert "default &lt;slope&gt;" in text
    assert "http://www.w3.org/2000/svg" in text
    assert "src=" not in text


def test_memory_and_time_are_seen() -> None:
    def work() -> float:
        block = np.ones(8 << 20)  # 64 MiB
        return float(block.sum())

    result, cost = meter.measure(work)
    assert result == 8 << 20
    assert cost.seconds > 0
    if cost.memory < 0:
        pytest.skip("this kernel does not let the peak of memory be reset")
    assert 60 < cost.memory < 80
