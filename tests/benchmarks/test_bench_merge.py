"""The benchmark runs, at a size that says nothing of speed; what it says of accuracy holds at any size."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks import merge_accuracy, merge_black
from kinran.__main__ import main


def test_the_benchmark_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["bench", "merge", "--megapixels", "0.1", "--sites", "100", "--out", "merge.json"]) == 0
    results = json.loads((tmp_path / "merge.json").read_text())
    assert {"machine", "accuracy", "black", "speed", "memory", "tile"} <= set(results)
    assert results["speed"]["kinran_estimator_msample_per_cpu_s"] > 0
    assert results["memory"]["peak_mb"] > results["memory"]["base_mb"]
    assert "kinran" in capsys.readouterr().out
    assert [path.name for path in tmp_path.iterdir()] == ["merge.json"]


def test_the_estimator_reaches_the_bound() -> None:
    """Over five decades: RMSE ≤ 1.03 times the bound, z-rms within 5 %; bias 0.1 % or what chance gives, at each level.

    The estimators that people write do not: hat weights and Debevec and Malik are biased by over 10 % in the dark.
    """
    found = merge_accuracy.measure(2000)["estimators"]
    for decade, errors in found["kinran"].items():
        chance = 4.5 * 1.3 * found["crb"][decade]["percent"] * np.sqrt(1 / 2000)
        assert errors["rmse_over_crb"] < 1.03, decade
        assert errors["z_rms"] == pytest.approx(1, abs=0.05)
        assert errors["worst_bias_percent"] < max(0.1, chance)
        assert errors["not_finite_percent"] == 0
    assert found["hat weights, linear"]["1e4"]["worst_bias_percent"] > 10
    assert found["Debevec-Malik, 8 bit"]["1e4"]["worst_bias_percent"] > 10


def test_the_bound_is_that_of_photons_where_they_alone_count() -> None:
    """At 3·10⁵ electrons a second only shot noise is left, to 10 %; no exposure but the longest is much of it."""
    rate = 3e5
    total = (merge_accuracy.SECONDS * rate).sum()
    assert merge_accuracy.bound(rate) == pytest.approx(1 / np.sqrt(total), rel=0.1)


def test_black_levels_of_all_kinds_leave_no_bias(tmp_path: Path) -> None:
    """By site, row and fraction, stated or not: within 0.35 % of the clean sensor, and of truth within chance.

    Taken as stated, 63 for 63.4 costs 2 %, and 2048 for 2045 and 2053 more.
    """
    found = merge_black.measure(tmp_path, 384, 648)
    assert set(found) == set(merge_black.CASES)
    for name, row in found.items():
        jumps = 2.5 if "jump" in name else 1.0  # what is left of them is noise that sites of a row share
        assert row["worst_change_percent"] < 0.35 * jumps, name
        assert abs(row["worst_bias_percent"]) < 0.1 + 4 * jumps * row["standard_error_percent"], name
        assert row["z_rms"] == pytest.approx(1, abs=0.02)
        assert row["worst_ratio_percent"] < 0.05, name
