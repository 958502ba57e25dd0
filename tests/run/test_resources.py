"""What jobs ask of a machine: it grows with the fabric and with the attempts, and is known before a fabric is read."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from kinran.run import fabrics as sheets
from kinran.run.resources import (
    CAMERA_TEXELS,
    COSTS,
    LEAST_MINUTES,
    MOST_THREADS,
    SHOT_S,
    Size,
    capture_seconds,
    memory_mb,
    minutes,
    size_of,
    threads,
)

SMALL, LARGE = Size(80 * 80, 385), Size(2_500_000, 1153)
"""The demo's fabric, and one of 10.1 megapixels under the paper's grid."""


@pytest.mark.parametrize("stage", COSTS)
def test_a_new_attempt_asks_for_more(stage: str) -> None:
    asked = [(memory_mb(stage, LARGE, attempt), minutes(stage, LARGE, attempt)) for attempt in (1, 2, 3)]
    assert sorted(set(asked)) == asked
    assert asked[1][0] >= 1.3 * asked[0][0]
    assert asked[1][1] == 2 * asked[0][1]


@pytest.mark.parametrize("stage", COSTS)
def test_a_larger_fabric_never_asks_for_less(stage: str) -> None:
    assert memory_mb(stage, LARGE) >= memory_mb(stage, SMALL)
    assert minutes(stage, LARGE) >= minutes(stage, SMALL) >= LEAST_MINUTES
    assert MOST_THREADS >= threads(stage, LARGE) >= threads(stage, SMALL) >= 1


def test_stages_of_texels_scale() -> None:
    """From the demo to ten megapixels a merge takes more memory, a fit more time, and a prior more threads."""
    assert memory_mb("merge", LARGE) > memory_mb("merge", SMALL) + 100
    assert minutes("fit", LARGE) > 5 * minutes("fit", SMALL)
    assert minutes("fit", LARGE, threads=16) < minutes("fit", LARGE) / 5
    assert threads("sigma", LARGE) == MOST_THREADS
    assert threads("sigma", SMALL) == 2
    assert threads("merge", LARGE) == 1


def fabric(folder: Path, source: str, crop: str = "") -> sheets.FabricRow:
    """A fabric with settings for a test."""
    (folder / "a.xml").touch()
    (folder / "fabrics.tsv").write_text(
        f"fabric\tsource\tencoding\tcrop\tregions\tseeds\nsilk\t{source}\t\t{crop}\t\t\n"
    )
    rig = {"device": "virtual", "thetas": [0, 40], "phis": 8, "exposures": [25, 1000], "meridians": 8}
    rig.update(lamp_mm=600, field_mm=4.8)
    config: dict[str, Any] = {"fabrics": str(folder / "fabrics.tsv"), "recapture": str(folder / "none.tsv"), "rig": rig}
    (folder / "none.tsv").touch()
    config.update(virtual={"texels": 24, "samples": 1, "seed": 1}, fit={"model": "slope", "compare": []})
    config.update(scene={"template": str(folder / "a.xml"), "scan": "generated"})
    return sheets.read_fabrics(config).sound["silk"]


def photographs(folder: Path, width: int, height: int) -> str:
    folder.mkdir()
    Image.fromarray(np.zeros((height, width, 3), np.uint8)).save(folder / "p0.png")
    (folder / "a.lp").write_text("1\np0.png 0 0 1\n")
    return str(folder)


def test_size_of_the_virtual_fabric(tmp_path: Path) -> None:
    assert size_of(fabric(tmp_path, "rig"), tmp_path) == Size(24 * 24, 9)


def test_size_of_photographs_is_that_of_the_first_or_of_its_crop(tmp_path: Path) -> None:
    source = photographs(tmp_path / "set", 40, 30)
    assert size_of(fabric(tmp_path, source), tmp_path) == Size(1200, 1)
    assert size_of(fabric(tmp_path, source, "2,3,10,20"), tmp_path) == Size(200, 1)


def test_size_of_a_rig_is_that_of_its_frames(tmp_path: Path) -> None:
    """Before there are any, it is that of the paper's camera."""
    row = fabric(tmp_path, "rig")
    row.settings["rig"]["device"] = "none"
    assert size_of(row, tmp_path) == Size(CAMERA_TEXELS, 9)
    groups = tmp_path / "silk" / "groups"
    groups.mkdir(parents=True)
    Image.fromarray(np.zeros((7, 9, 3), np.uint8)).save(tmp_path / "silk" / "frame.png")
    (groups / "00.json").write_text(json.dumps({"shots": [{"frames": [{"file": "frame.png"}]}]}))
    assert size_of(row, tmp_path) == Size(63, 9)
    (groups / "00.json").write_text("{")
    assert size_of(row, tmp_path) == Size(CAMERA_TEXELS, 9)


def test_what_cannot_be_read_is_left_to_the_job_that_reads_it(tmp_path: Path) -> None:
    source = photographs(tmp_path / "set", 40, 30)
    (tmp_path / "set" / "p0.png").write_bytes(b"no picture")
    assert size_of(fabric(tmp_path, source), tmp_path).texels == CAMERA_TEXELS


def test_a_virtual_capture_takes_longer_with_more_rays_and_less_on_two_cores(tmp_path: Path) -> None:
    row = fabric(tmp_path, "rig")
    group = row.light_groups[0]
    one = capture_seconds(row, group, 1, tmp_path)
    assert 0 < capture_seconds(row, "calibration", 1, tmp_path) < one
    assert capture_seconds(row, group, 2, tmp_path) == one / 2
    row.settings["virtual"]["texels"] = 2400
    assert capture_seconds(row, group, 1, tmp_path) > 5 * one


def test_a_capture_of_a_rig_takes_its_share_of_the_plans_time(tmp_path: Path) -> None:
    """Without a plan it is a guess for each light."""
    row = fabric(tmp_path, "rig")
    row.settings["rig"]["device"] = "hid"
    assert capture_seconds(row, row.light_groups[0], 1, tmp_path) == SHOT_S * row.lights / len(row.light_groups)
    (tmp_path / "silk").mkdir()
    (tmp_path / "silk" / "plan.json").write_text('{"duration_s": 600}')
    assert capture_seconds(row, row.light_groups[0], 1, tmp_path) == 600 / len(row.all_groups)
