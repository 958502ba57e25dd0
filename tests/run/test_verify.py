"""`kinran verify`: which files are damaged, and what makes them again."""

import logging
import re
import shutil
from pathlib import Path

import pytest
from small_run import write_run

from kinran.__main__ import main
from kinran.base.files import read_json, write_json
from kinran.data.shards import shard_path
from kinran.run.void import remove_void


@pytest.fixture
def results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> Path:
    """Results of a run in the current folder."""
    caplog.set_level(logging.INFO)
    monkeypatch.chdir(tmp_path)
    write_run(tmp_path)
    return Path("results/swatch")


def flip(path: Path) -> None:
    """Flip a bit in the middle of a file."""
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 4
    path.write_bytes(data)


def test_a_sound_run(results: Path, caplog: pytest.LogCaptureFixture) -> None:
    (results / "table.csv").write_text("a,b\n")
    assert main(["verify"]) == 0
    files = sum(path.is_file() for folder in (Path("captures"), Path("results")) for path in folder.rglob("*"))
    assert f"swatch: {files} files checked, 0 damaged; without a checksum: table.csv" in caplog.text


@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("material.exr", "snakemake --forcerun results/swatch/material.exr"),
        ("fit/prior.json", "snakemake --forcerun results/swatch/fit/prior.json"),
        ("scene/mesh.ply", "snakemake --forcerun results/swatch/scene/mesh.ply"),
        ("render.png", "snakemake --forcerun results/swatch/render.png"),
        ("radiance.zarr/zarr.json", "snakemake --forcerun results/swatch/radiance.zarr/zarr.json"),
        (
            "radiance.zarr/radiance/c/2/0/0/0",
            "rm results/swatch/radiance.zarr/radiance/c/2/0/0/0 && snakemake",
        ),
    ],
)
def test_a_damaged_result_is_named_with_its_remedy(
    results: Path, name: str, command: str, caplog: pytest.LogCaptureFixture
) -> None:
    flip(results / name)
    assert main(["verify", "swatch"]) == 2
    assert re.search(rf"results/swatch/{name.removesuffix('/zarr.json')}\S*: ", caplog.text)
    assert f"to make them again:\n  {command}\n" in caplog.text
    assert "1 damaged" in caplog.text


def test_a_shard_in_the_place_of_another_is_told_by_its_receipt(
    results: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Its chunks are sound, and so is what Zarr reads."""
    one, other = (shard_path(results / "radiance.zarr", "flags", k) for k in (0, 1))
    one.write_bytes(other.read_bytes())
    assert main(["verify"]) == 2
    assert f"{one}: is not the shard that results/swatch/merged/00.json has the digest of" in caplog.text


def test_a_damaged_frame_and_a_torn_manifest(results: Path, caplog: pytest.LogCaptureFixture) -> None:
    frames = sorted(Path("captures/swatch/frames").rglob("*.png"))
    flip(frames[0])
    frames[1].unlink()
    assert main(["verify"]) == 2
    assert f"{frames[0]}: has other bytes than were recorded; restore it" in caplog.text
    assert f"{frames[1]}: is missing" in caplog.text
    assert "config/recapture.tsv" in caplog.text
    assert "to make them again" not in caplog.text  # no job can
    caplog.clear()
    manifest = sorted(Path("captures/swatch/groups").glob("*.json"))[0]
    flip(manifest)
    flip(Path("captures/swatch/plan.json"))
    assert main(["verify"]) == 2
    assert f"snakemake --forcerun captures/swatch/groups/{manifest.name} captures/swatch/plan.json\n" in caplog.text


def test_all_damage_is_said_at_once(results: Path, caplog: pytest.LogCaptureFixture) -> None:
    for name in ("labels.exr", "statistics.exr", "need.json"):
        flip(results / name)
    assert main(["verify"]) == 2
    assert "3 files are damaged" in caplog.text


def test_what_is_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["verify"]) == 2
    assert "has no captures and no results" in caplog.text
    assert main(["verify", "none"]) == 2
    assert "captures/none: no such folder" in caplog.text


def test_a_mesh_that_fabrics_share_is_checked_with_any_of_them(results: Path, caplog: pytest.LogCaptureFixture) -> None:
    shared = Path("results/_meshes/generated/mesh.ply")
    shared.parent.mkdir(parents=True)
    shutil.copy(results / "scene" / "mesh.ply", shared)
    assert main(["verify", "swatch"]) == 0
    flip(shared)
    assert main(["verify", "swatch"]) == 2
    assert f"snakemake --forcerun {shared}\n" in caplog.text


def test_the_number_of_runs_is_void_with_its_material(results: Path) -> None:
    runs, material = results / "fit" / ".slope.runs.json", results / "fit" / "slope.exr"
    material.touch()
    write_json(runs, {"runs": 3, "of": ""})
    remove_void(results)
    assert runs.is_file()
    material.unlink()
    remove_void(results)
    assert not runs.exists()


@pytest.mark.parametrize(("shard", "void"), [(1, {"zarr.json", "00.json"}), (2, {"zarr.json"})])
def test_receipts_of_shards_that_are_gone_are_void(
    results: Path, shard: int, void: set[str], caplog: pytest.LogCaptureFixture
) -> None:
    """And `zarr.json`, without which Snakemake would not miss a receipt; what is whole stays."""
    files = {path.name: path for path in (results / "radiance.zarr" / "zarr.json", results / "merged" / "00.json")}
    remove_void(results)
    remove_void(Path("results/none"))
    assert all(path.is_file() for path in files.values())
    assert caplog.text == ""
    shard_path(results / "radiance.zarr", "flags", shard).unlink()
    remove_void(results)
    assert {name for name, path in files.items() if not path.exists()} == void
    for name in void:
        assert f"flags/c/{shard}/0/0/0: is gone; {files[name]}, which says" in caplog.text


def test_a_damaged_receipt_is_left_to_the_stage_that_reads_it(results: Path) -> None:
    receipt = results / "merged" / "00.json"
    flip(receipt)
    shard_path(results / "radiance.zarr", "radiance", 1).unlink()
    remove_void(results)
    assert receipt.is_file()


def test_a_receipt_of_an_earlier_version_has_no_digests(results: Path, caplog: pytest.LogCaptureFixture) -> None:
    receipt = results / "merged" / "00.json"
    write_json(receipt, {name: value for name, value in read_json(receipt).items() if name != "sha256"})
    assert main(["verify"]) == 2
    assert "merged/00.json: an earlier version merged its group" in caplog.text
