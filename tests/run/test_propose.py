"""A sheet that grows: its first group, the groups that follow from a fit, and when no further one does."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from synthetic_texels import radiance, texels

from kinran.base import frames
from kinran.base.files import InputError
from kinran.capture.directions import read_directions
from kinran.data.labels import Region, write_labels, write_regions
from kinran.data.radiance import Radiance
from kinran.data.radiance_stack import Light, Metadata, write_metadata, write_shards
from kinran.fit import learned_priors
from kinran.fit.region_priors import Priors
from kinran.fit.samples import Samples
from kinran.fit.slope_lobes import Lobes
from kinran.run import propose

SIDE = 8
OPTIONS = propose.Options(error=0.05, most=64)


def listed(sheet: Path) -> np.ndarray:
    """Directions (n, 3) of a sheet."""
    rows = [(each.theta, each.phi) for own in read_directions(sheet).groups.values() for each in own]
    return frames.direction(*np.radians(rows).T)


def shot(sheet: Path, folder: Path, error: float = 0.3) -> propose.Inputs:
    """What the workflow makes of a sheet: a stack, labels, priors and an evaluation."""
    folder.mkdir(exist_ok=True)
    directions = np.concatenate([listed(sheet), [[0, 0, 1]]])
    held = (np.arange(len(directions)) % 8 == 4) & (np.arange(len(directions)) < len(directions) - 1)
    T = radiance(*texels(SIDE * SIDE), directions)
    images = T.transpose(2, 0, 1).reshape(-1, SIDE, SIDE, 3)
    write_shards(folder / "radiance.zarr", 0, Radiance.unflagged(images))
    lights = tuple(
        Light(f"l{k}", tuple(d.tolist()), held_out=bool(h))
        for k, (d, h) in enumerate(zip(directions, held, strict=True))
    )
    write_metadata(folder / "radiance.zarr", Metadata(lights, SIDE, SIDE, 0.1, "", "", "Rec. 709", np.eye(3), {}))
    labels = np.zeros((SIDE, SIDE), np.intp)
    write_labels(
        folder / "labels.exr", labels, *(np.ones((SIDE, SIDE), np.float32), labels), np.ones((SIDE, SIDE), "f4")
    )
    write_regions(folder / "regions.json", [Region(0, "red", SIDE * SIDE, (1.0, 0.0, 0.0), 1.0)])
    samples = Samples.far(
        np.ascontiguousarray(T[:, :, ~held]), np.ones((len(T), (~held).sum()), "f4"), directions[~held]
    )
    priors = Priors(learned_priors.learn_priors(samples, 1, Lobes()), np.ones((~held).sum(), np.float32))
    priors.write(folder / "prior.json", [light for light in lights if not light.held_out])
    of = {"relative_error": error, "lights": {f"l{k}": {"relative_error": error} for k in np.flatnonzero(held)}}
    (folder / "evaluation.json").write_text(json.dumps({"default": "slope", "methods": {"slope": of}}))
    return propose.Inputs(folder, folder / "prior.json", folder / "evaluation.json")


def test_a_sheet_begins_even(tmp_path: Path) -> None:
    sheet = tmp_path / "directions.tsv"
    propose.main(propose.Inputs(), sheet, OPTIONS)
    found = listed(sheet)
    assert len(found) == propose.FIRST
    s = frames.slopes(np.delete(found, [4, 12], 0))
    assert (np.linalg.norm(s[:, None] - s, axis=2) + np.eye(len(s))).min() > 0.3
    np.testing.assert_allclose(found[[4, 12]], [propose.judge(0), propose.judge(1)], atol=2e-4)


def test_a_group_is_added_and_judged_by_lights_that_no_fit_chose(tmp_path: Path) -> None:
    sheet = tmp_path / "directions.tsv"
    propose.main(propose.Inputs(), sheet, OPTIONS)
    before = sheet.read_text()
    for total in (24, 32):
        propose.main(shot(sheet, tmp_path / f"{total}"), sheet, OPTIONS)
        assert sheet.read_text().startswith(before)
        before = sheet.read_text()
        assert list(map(len, read_directions(sheet).groups.values())) == [16, *[8] * ((total - 16) // 8)]
    found = listed(sheet)
    np.testing.assert_allclose(found[4::8], [propose.judge(k) for k in range(4)], atol=2e-4)
    rounds = json.loads(sheet.with_suffix(".json").read_text())
    assert [r["directions"] for r in rounds] == [16, 24]
    assert all(0.3 * r["error"] < r["expected"] < r["error"] for r in rounds)


def test_results_of_another_sheet_add_nothing(tmp_path: Path) -> None:
    """As after a kill between the group and its workflow: asked twice, a sheet gets one group."""
    sheet = tmp_path / "directions.tsv"
    propose.main(propose.Inputs(), sheet, OPTIONS)
    given = shot(sheet, tmp_path / "results")
    propose.main(given, sheet, OPTIONS)
    before = sheet.read_bytes()
    with pytest.raises(InputError, match=r"has 24 directions, and .* was taken under 16"):
        propose.main(given, sheet, OPTIONS)
    assert sheet.read_bytes() == before


def test_enough_is_enough(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A low error under two lights is none yet; under six it is; and so is the largest number."""
    sheet = tmp_path / "directions.tsv"
    propose.main(propose.Inputs(), sheet, OPTIONS)
    given = shot(sheet, tmp_path / "a", error=0.01)
    propose.main(given, sheet, OPTIONS)
    assert len(listed(sheet)) == 24
    for most in (24, 30):
        propose.main(shot(sheet, tmp_path / "b"), sheet, replace(OPTIONS, most=most))
        assert len(listed(sheet)) == 24
    assert "stops" in capsys.readouterr().out
    rows = propose.rows_of(propose.candidates()[100:800:30], 24, 24, 8)
    lines = [f"{theta}\t{phi}\t3" for theta, phi in rows]
    sheet.write_text(sheet.read_text().replace("\t1\n", "\t1\n") + "\n".join(lines).replace("\t3", "\t2") + "\n")
    propose.main(shot(sheet, tmp_path / "c", error=0.01), sheet, OPTIONS)
    assert len(listed(sheet)) == 48
    assert "done; 48 directions: error 0.010 ± 0.000 on 6 lights" in capsys.readouterr().out


@pytest.mark.parametrize("change", [{"error": 0.0}, {"most": 8}, {"holdout": 0}])
def test_options_out_of_range(tmp_path: Path, change: dict) -> None:
    with pytest.raises(InputError, match="give an error over 0"):
        propose.main(propose.Inputs(), tmp_path / "directions.tsv", replace(OPTIONS, **change))
    assert not list(tmp_path.iterdir())


def test_judges_are_even() -> None:
    """Wherever they end: 16 and 64 of them fill the hemisphere down to 80° as evenly as their number allows."""
    for count in (16, 64):
        v = np.array([propose.judge(k) for k in range(count)])
        assert v[:, 2].min() > np.cos(np.radians(80.1))
        nearest = np.sort(np.arccos(np.clip(v @ v.T, -1, 1)), axis=1)[:, 1]
        assert nearest.min() > 0.5 * np.sqrt(2 * np.pi * (1 - np.cos(np.radians(80))) / count) * 0.6
