"""Photographs become a capture; bad sets are refused before anything is written."""

from pathlib import Path

import imagecodecs
import numpy as np
import pytest
from PIL import Image

from kinran.__main__ import main
from kinran.base import digest
from kinran.base.files import InputError, read_json
from kinran.capture import ingest, ingest_group
from kinran.capture.photograph_set import Known, inspect
from kinran.data.capture_plan import read_plan, write_plan


def make_set(folder: Path, lights: int = 16, size: tuple[int, int] = (12, 10)) -> Path:
    """A folder of small photographs with a `.lp` file."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    rows = [str(lights)]
    for k in range(lights):
        Image.fromarray(rng.integers(0, 255, (*size, 3), dtype=np.uint8)).save(folder / f"img {k:02d}.png")
        rows.append(f"img {k:02d}.png {np.cos(k) * 0.5:.6f} {np.sin(k) * 0.5:.6f} 0.8660254")
    (folder / "dirs.lp").write_text("\n".join(rows) + "\n")
    return folder


def test_plan_and_manifests(tmp_path: Path) -> None:
    folder = make_set(tmp_path / "set", 70)
    found = inspect(folder, Known(), 8)
    write_plan(tmp_path / "captures" / "plan.json", ingest.plan("icon", found, Known()))
    plan = read_plan(tmp_path / "captures" / "plan.json")
    assert [len(group.lights) for group in plan.groups] == [64, 6]
    assert plan.lights[69].name == "img 69"
    rows = ingest_group.manifest(tmp_path / "captures" / "plan.json", "01", folder)["shots"]
    assert [row["shot"] for row in rows] == [f"img {k}" for k in range(64, 70)]
    assert all(Path(row["frames"][0]["file"]).is_file() for row in rows)


def break_truncated(folder: Path) -> None:
    path = folder / "img 03.png"
    path.write_bytes(path.read_bytes()[:100])


def break_missing(folder: Path) -> None:
    (folder / "img 05.png").unlink()


def break_size(folder: Path) -> None:
    Image.new("RGB", (9, 9)).save(folder / "img 07.png")


def break_count(folder: Path) -> None:
    lp = folder / "dirs.lp"
    lp.write_text(lp.read_text().replace("16\n", "17\n", 1))


def break_two_lp(folder: Path) -> None:
    (folder / "other.lp").write_text("")


def break_no_lp(folder: Path) -> None:
    (folder / "dirs.lp").unlink()


def break_zero(folder: Path) -> None:
    lp = folder / "dirs.lp"
    lines = lp.read_text().splitlines()
    lines[3] = "img 02.png 0 0 0"
    lp.write_text("\n".join(lines))


def break_twice(folder: Path) -> None:
    lp = folder / "dirs.lp"
    lp.write_text(lp.read_text().replace("img 02.png", "img 01.png", 1))


@pytest.mark.parametrize(
    ("damage", "options", "says"),
    [
        (break_truncated, [], "img 03.png: is truncated or broken"),
        (break_missing, [], "img 05.png: no such image"),
        (break_size, [], "img 07.png: is 9x9 but img 00.png is 10x12"),
        (break_count, [], "says 17 lights but 16 follow"),
        (break_two_lp, [], "keep one .lp file"),
        (break_no_lp, [], "has no .lp file"),
        (break_zero, [], "line 4 (img 02.png) has the light vector 0.0 0.0 0.0"),
        (break_twice, [], "names 'img 01' again"),
        (None, ["--crop", "5,5,20,20"], "too small for the crop 5,5,20,20"),
        (None, ["--crop", "1,2,3"], "crop '1,2,3': give X,Y,W,H"),
        (None, ["--encoding", "rec709"], "encoding 'rec709'"),
        (None, ["--holdout", "40"], "no light of 16 is left to hold out"),
        (None, ["--holdout", "1"], "--holdout 1: give 0 for none, or 2 and more"),
        (None, ["--holdout", "-3"], "--holdout -3"),
    ],
)
def test_bad_sets_stop_before_anything_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], damage: object, options: list[str], says: str
) -> None:
    folder = make_set(tmp_path / "set")
    if callable(damage):
        damage(folder)
    assert main(["rti", str(folder), "--out", str(tmp_path / "out"), *options]) == 2
    error = capsys.readouterr().err
    assert says in error
    assert len(error.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_a_folder_that_is_not_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["rti", str(tmp_path / "none"), "--out", str(tmp_path / "out")]) == 2
    assert "no such folder" in capsys.readouterr().err


def test_an_output_folder_that_cannot_be_written_to(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = make_set(tmp_path / "set")
    (tmp_path / "file").write_text("")
    assert main(["rti", str(folder), "--out", str(tmp_path / "file" / "out")]) == 2
    assert "choose another output folder" in capsys.readouterr().err


def test_too_few_lights(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="4 are needed"):
        inspect(make_set(tmp_path / "set", 3), Known(), 0)


def test_manifest_is_json_that_says_where_the_photographs_are(tmp_path: Path) -> None:
    folder = make_set(tmp_path / "set")
    plan, out, of = str(tmp_path / "plan.json"), str(tmp_path / "00.json"), ["--folder", str(folder)]
    assert main(["ingest", *of, "--fabric", "icon", "--holdout", "8", plan]) == 0
    assert main(["ingest-group", *of, "--plan", plan, "--group", "00", out]) == 0
    assert read_json(tmp_path / "00.json")["lights"] == list(range(16))


@pytest.mark.parametrize("stage", ["ingest", "ingest_group"])
def test_no_change_of_the_merge_ingests_a_set_again(stage: str) -> None:
    """The stage's digest holds nominal times and RAW headers, but no estimator and no calibration."""
    held = digest.modules(f"kinran.capture.{stage}")
    assert {name.split(".")[1] for name in held} == {"base", "capture", "data"}
    assert {"kinran.data.nominal_time", "kinran.data.raw"} <= set(held)
    assert "kinran.data.calibration" not in held


def test_photographs_of_other_exposures(tmp_path: Path) -> None:
    """ISO, aperture and time of EXIF have to agree, in photographs alone as in RAW files."""
    folder = make_set(tmp_path / "set")
    exif = Image.Exif()
    exif.get_ifd(0x8769).update({0x829A: 0.01, 0x8827: 200})
    for k in range(16):
        path = folder / f"img {k:02d}.png"
        Image.open(path).save(path.with_suffix(".jpg"), exif=exif)
        path.unlink()
    inspect(folder, Known(), 8)
    exif.get_ifd(0x8769)[0x8827] = 400
    Image.open(folder / "img 07.jpg").save(folder / "img 07.jpg", exif=exif)
    with pytest.raises(InputError, match=r"img 07\.jpg: was taken with ISO 400 but img 00\.jpg with ISO 200"):
        inspect(folder, Known(), 8)


def test_names_of_another_dome_go_by_their_order(tmp_path: Path) -> None:
    """One file of a dome serves every object; numbers count by their value, and the run says so."""
    folder = make_set(tmp_path / "set", 12)
    for k in range(12):
        (folder / f"img {k:02d}.png").rename(folder / f"IMG_{k + 4}.png")
    (folder / "dirs.lp").rename(tmp_path / "dome.lp")
    found = inspect(folder, Known(lp=tmp_path / "dome.lp"), 8)
    assert "names none of the 12 photographs" in found.remarks[0]
    write_plan(tmp_path / "plan.json", ingest.plan("icon", found, Known()))
    rows = ingest_group.manifest(tmp_path / "plan.json", "00", folder, tmp_path / "dome.lp")["shots"]
    assert [Path(row["frames"][0]["file"]).name for row in rows] == [f"IMG_{k + 4}.png" for k in range(12)]
    (folder / "chart.png").write_bytes((folder / "IMG_4.png").read_bytes())
    with pytest.raises(InputError, match="with as many pictures as lights, 12 and not 13"):
        inspect(folder, Known(lp=tmp_path / "dome.lp"), 8)


def test_a_profile_that_contradicts_the_encoding(tmp_path: Path) -> None:
    folder = make_set(tmp_path / "set")
    profile = imagecodecs.cms_profile("adobergb")
    Image.open(folder / "img 00.png").save(folder / "img 00.png", icc_profile=profile)
    inspect(folder, Known(), 8)
    with pytest.raises(InputError, match=r"--encoding linear: but .*img 00\.png embeds the colour profile"):
        inspect(folder, Known(encoding="linear"), 8)
