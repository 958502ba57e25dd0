"""The overview: all fabrics of a run, and why some did not finish."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from kinran.base.files import InputError, write_json
from kinran.report import overview


def finished(results: Path, name: str) -> Path:
    """The errors of a fabric, with its render beside them."""
    share = {"texels_above_1": 0.0, "texels_above_white": 0.0}
    method = {"relative_error": 0.25, "psnr": 31.5, **share, "fit": {"microseconds_per_texel": 12}}
    best = {"relative_error": 0.2, "psnr": 30.0}
    beside = {
        "texels": 16,
        "whole": True,
        "material": {"relative_error": 0.25, "psnr": 31.5},
        "baselines": {"PTM": best},
    }
    path = results / name / "evaluation.json"
    errors = {"fabric": name, "default": "slope", "training_lights": 9, "held_out": ["a"], "beside": beside}
    write_json(path, {**errors, "methods": {"slope": method}})
    Image.fromarray(np.zeros((4, 4, 3), np.uint8)).save(path.with_name("render.png"))
    return path


def page(results: Path, *errors: Path) -> str:
    overview.main(overview.Inputs(results / "failures.json", errors), results / "report.html")
    return (results / "report.html").read_text()


def test_a_page_without_failures(tmp_path: Path) -> None:
    write_json(tmp_path / "failures.json", {"run": "", "failures": []})
    text = page(tmp_path, finished(tmp_path, "silk"))
    assert '<a href="silk/report.html">silk</a></td><td>9</td><td>1</td>' in text
    assert "1 fabric: held-out" in text
    assert "Not finished" not in text
    assert "the best simple baseline, PTM, has 30.00 dB" in text
    assert "<b>Warning:</b> PTM is better than the material: relative error 0.200 against 0.250." in text


def test_a_failure_has_its_sentence_and_its_log(tmp_path: Path) -> None:
    failure = {"fabric": "wool", "stage": "fit", "says": "has < 3 lights", "log": "logs/wool/fit.log"}
    write_json(tmp_path / "failures.json", {"run": "a.log", "failures": [failure]})
    text = page(tmp_path, finished(tmp_path, "silk"))
    assert "<td>wool</td><td>fit</td><td>has &lt; 3 lights</td>" in text
    assert "logs/wool/fit.log</a>" in text
    assert "2 fabrics, 1 not finished" in text


def test_a_damaged_fabric_takes_none_with_it(tmp_path: Path) -> None:
    write_json(tmp_path / "failures.json", {"run": "", "failures": []})
    silk, wool = finished(tmp_path, "silk"), finished(tmp_path, "wool")
    wool.with_name("render.png").write_bytes(b"no picture")
    with pytest.raises(InputError, match=r"wool/render\.png"):
        page(tmp_path, silk, wool)
    text = (tmp_path / "report.html").read_text()
    assert '<a href="silk/report.html">' in text
    assert "<td>wool</td><td>overview</td>" in text
