"""From the rows of an experiment to front, table, drawing and page."""

import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from trials import shiny_trial

from kinran.base.drawing import canvas
from kinran.base.files import InputError, write_json
from kinran.compare import chart_page, experiments, figure, front, meter, panels, rows, stability
from kinran.compare import chart_table as joining
from kinran.compare.method import Method
from kinran.compare.methods import linear, methods
from kinran.compare.rows import Row


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


CHEAP = ("PTM", "Lambert", "Delaunay", "HSH 16", "four steps", "PCA 16", "Lafortune")


@pytest.fixture(scope="module")
def table() -> list[Row]:
    """All experiments on the small trial, with a default that is 10 % too bright."""
    tried = shiny_trial()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(meter, "bandwidth", lambda: 1e10)
        default = Method("default <slope>", "default", linear.METHODS[0].fit, 4, True)
        found = experiments.run(tried, "cloth", [m for m in methods() if m.name in CHEAP])
        cost = {"microseconds": 5.0, "bytes": 28.0, "memory_mb": 2.0}
        found += experiments.judged("cloth", default, tried.truth * np.float32(1.1), tried, cost)
        found += experiments.with_less(tried, "cloth", default)
    for method, share in (("Mahalanobis", 0.98), ("EM", 0.9)):
        found.append(Row("cloth", "segmentation", "all texels", method, "baseline", 45, {"accuracy": share}))
    return joining.joined([*found, FLOOR])


def test_experiments_cover_what_the_chart_draws(table: list[Row]) -> None:
    found = {name: [r for r in table if r.experiment == name] for name in {r.experiment for r in table}}
    assert set(found) == {"floor", "all", "theta", "region", "directions", "exposures",
        "ring", "extrapolation", "segmentation"}  # fmt: skip
    assert [r.setting for r in found["directions"] if r.method == "PTM"] == ["45", "30", "16"]
    assert [r.setting for r in found["exposures"] if r.method == "PTM"] == ["3", "2"]
    assert {r.setting for r in found["region"]} == {"gold", "red"}
    assert next(r for r in found["all"] if r.family == "default")["relative_error"] == pytest.approx(0.1, rel=1e-4)
    assert all(r.lights == 45 for r in found["all"])
    assert {r.setting for r in found["ring"]} == {r.setting for r in found["theta"]}
    assert all(r.lights < 45 for r in found["ring"])
    assert {r.method for r in found["directions"]} == {"default <slope>", *CHEAP} - {"Lambert"}


def test_joined_tables_have_the_least_floor_and_the_default_first(table: list[Row]) -> None:
    floors = [r["microseconds"] for r in table if r.experiment == "floor"]
    assert floors == pytest.approx([1e6 * 45 * 12 / 1e10])  # under the 0.5 of the other one
    whole = [r for r in table if r.experiment == "all"]
    assert whole[0].family == "default"
    sizes = [r["bytes"] for r in whole if r.family == "baseline"]
    assert sizes == sorted(sizes)


def test_fewer_exposures_and_lights_are_worse_for_interpolation(table: list[Row]) -> None:
    for experiment, order in (("exposures", ("3", "2")), ("directions", ("45", "16"))):
        own = {r.setting: r["relative_error"] for r in table if r.experiment == experiment and r.method == "Delaunay"}
        assert own[order[0]] < own[order[1]]


def test_extrapolation_is_worse_than_interpolation(table: list[Row]) -> None:
    own = {(r.experiment, r.setting): r["relative_error"] for r in table if r.method == "PTM" and r.setting == "65–90°"}
    assert own["extrapolation", "65–90°"] > own["ring", "65–90°"] > own["theta", "65–90°"]


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


def boxes(drawing: canvas.Canvas) -> list[tuple[float, float, float, float]]:
    """Of the names at the dots: left, top, right, bottom, as they are drawn."""
    found = []
    for mark in drawing.marks:
        if mark.kind == "text" and mark.series:
            (x, y), width = mark.points[0], 5.6 * len(mark.text)
            found.append((x, y - 9, x + width, y + 2))
    return found


def test_names_do_not_overlap_though_dots_are_close() -> None:
    rng = np.random.default_rng(0)
    crowd = [
        row(f"method number {k}", "kinran", *(float(v) for v in np.exp(rng.normal(3, 0.15, 2))), 0.1 + 0.003 * k)
        for k in range(16)
    ]
    drawing = panels.against_cost([FLOOR, *crowd], "microseconds", "relative_error")
    assert drawing
    found = boxes(drawing)
    assert len(found) == 16
    for k, a in enumerate(found):
        for b in found[:k]:
            assert min(a[2], b[2]) <= max(a[0], b[0]) or min(a[3], b[3]) <= max(a[1], b[1])


def test_the_floor_says_its_number() -> None:
    drawing = panels.against_cost([FLOOR, row("PTM", "baseline", 1, 36, 0.8)], "microseconds", "relative_error")
    assert drawing
    (label,) = [mark.text for mark in drawing.marks if mark.text.startswith("floor")]
    assert "0.5 µs" in label
    assert "2.4 GB/s" in label  # 100 lights × 12 bytes in 0.5 µs


def test_nothing_is_drawn_of_what_was_not_measured() -> None:
    assert panels.against_cost([FLOOR, row("PTM", "baseline", 1, 36, 0.8)], "memory_mb", "relative_error") is None


def test_exploded_errors_are_drawn_at_the_edge() -> None:
    table = [FLOOR, row("default (slope)", "default", 10, 28, 0.1), row("PTM", "baseline", 1, 36, 0.8)]
    for setting, value in (("100", 0.1), ("30", 2000.0), ("16", math.inf)):
        table.append(Row("cloth", "directions", setting, "PTM", "baseline", 16, {"relative_error": value}))
    drawing = figure.draw(table)
    assert all(math.isfinite(v) for mark in drawing.marks for point in mark.points for v in point)


def test_page_holds_the_charts_of_all_fabrics(table: list[Row], tmp_path: Path) -> None:
    rows.write(tmp_path / "a.csv", table)
    rows.write(tmp_path / "b.csv", [FLOOR, row("</script><b>", "default", 10, 28, 0.1)])
    write_json(tmp_path / "s.json", stable())
    inputs = chart_page.Inputs((tmp_path / "a.csv", tmp_path / "b.csv"), tmp_path / "s.json")
    chart_page.main(inputs, tmp_path / "chart.html")
    text = (tmp_path / "chart.html").read_text(encoding="utf-8")
    first, second, last = text.split("<section>")[1:]
    shown = [f'data-x="{x}" data-y="{y}"' for x in panels.COSTS for y in panels.MEASURES if y != "texels_above_1"]
    assert all(first.count(plot) == second.count(plot) == 1 for plot in shown)
    assert first.count("<svg") == 1 + len(shown)
    assert second.count("<svg") == 1 + 2 * 2  # its rows have no memory, and two of the measures
    assert second.count("Not measured.") == len(shown) - 2 * 2
    assert '<option value="relative_error" selected>' in first
    assert first.count(" hidden>") == second.count(" hidden>") == len(shown) - 1
    assert "Eq. &lt;3&gt;" in last
    assert '<td class="failed">0.700</td>' in last
    assert "default <slope>" not in text
    assert "default &lt;slope&gt;" in first
    assert "</script><b>" not in text
    assert "&lt;/script&gt;&lt;b&gt;" in second
    assert "http://www.w3.org/2000/svg" in text
    assert "src=" not in text
    assert "href=" not in text


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


def stable() -> dict[str, list[dict[str, object]]]:
    """One case as `kinran bench stability` writes it."""
    row = {"case": "pole", "parameter": "0°", "method": "Eq. <3>", "error": 0.05}
    worst = {"case": "pole", "parameter": "5°", "fails": "Eq. <3>", "error_failing": 0.7}
    return {
        "rows": [
            row,
            {**row, "parameter": "5°", "error": 0.7},
            {**row, "parameter": "5°", "method": "x", "error": None},
        ],
        "summary": [{**worst, "holds": "x", "error_holding": 0.25}],
    }


def test_a_table_of_stability_that_is_none_is_refused(tmp_path: Path) -> None:
    write_json(tmp_path / "s.json", [{"case": "pole", "error": 1}])
    with pytest.raises(InputError, match="no rows of case"):
        stability.read(tmp_path / "s.json")


def stability_section(folder: Path) -> str:
    """Section of a page with the table that stands in a folder."""
    rows.write(folder / "chart.csv", [FLOOR, row("default (slope)", "default", 10, 28, 0.1)])
    chart_page.main(chart_page.Inputs((folder / "chart.csv",), folder / "s.json"), folder / "chart.html")
    return (folder / "chart.html").read_text(encoding="utf-8").split("<section>")[-1]


def test_table_of_stability_has_a_cell_for_what_was_measured_and_none_for_what_was_not(tmp_path: Path) -> None:
    write_json(tmp_path / "s.json", stable())
    text = stability_section(tmp_path)
    assert '<tr><td>0°</td><td class="held">0.050</td><td></td></tr>' in text
    assert '<tr><td>5°</td><td class="failed">0.700</td><td class="failed">not finite</td></tr>' in text
    assert (
        '<td class="word">Eq. &lt;3&gt;</td><td class="failed">0.700</td><td class="word">x</td><td>0.250</td>' in text
    )


def test_the_table_reads_what_the_benchmark_writes(tmp_path: Path) -> None:
    """Its narrowest case alone, on few lights."""
    from benchmarks import stability as bench

    rows = [bench._row("pole", "5°", name, np.array([value])) for name, value in (("a", 0.5), ("b", np.nan))]
    value = {"rows": rows, "summary": [bench.worst([*rows[:1], bench._row("pole", "5°", "c", np.ones(1))], "a", "c")]}
    write_json(tmp_path / "s.json", value)
    assert "not finite" in stability_section(tmp_path)


def test_what_has_no_fit_is_on_the_front_of_bytes_alone() -> None:
    kept = row("kept", "baseline", 0, 600, 0.05)
    assert panels.counts(kept, "bytes")
    assert not panels.counts(kept, "microseconds")
    rows_ = [kept, row("slow", "kinran", 10, 28, 0.06), row("quick", "baseline", 1, 36, 0.5)]

    def filled(cost: str) -> set[str]:
        drawing = panels.against_cost(rows_, cost, "relative_error")
        assert drawing
        return {m.series for m in drawing.marks if m.kind == "dot" and m.series and m.colour in FULL}

    assert filled("microseconds") == {"slow", "quick"}
    assert filled("bytes") == {"slow", "kept"}


FULL = set(panels.FAMILIES.values())
