"""The stage by its files."""

import json
import subprocess
import sys
from pathlib import Path

import imagecodecs
import numpy as np
import plate
import pytest
import yaml
from register_session import Session

from kinran.base.exr import read_exr
from kinran.base.files import InputError
from kinran.register.register import Options, find_views, main

ROOT = Path(__file__).parents[2]


def test_report_tells_plane_from_height(registered: Path) -> None:
    """What a real session can know: the shift by phase correlation, against its own floor."""
    report = json.loads((registered / "register.json").read_text())
    assert report["registered"]
    assert report["warnings"] == []
    assert report["floor_mm"] == pytest.approx(0.07 * report["texel_mm"])
    for row in report["views"][1:]:
        assert row["median_mm"] < 0.015
        assert row["p95_mm"] < 0.04
        assert row["patches"] == row["patches_tried"]
        if row["theta"] > 1.0:
            assert row["plane_median_mm"] > 0.8  # where it is largest, the patches have nothing left in common
            assert row["plane_patches"] < row["patches"]


def test_pycolmap_is_asked_for_by_name() -> None:
    """It is an extra of the package: one sentence where it is missing, and no other command needs it."""
    code = "import sys; sys.modules['pycolmap'] = None; from kinran.__main__ import main; sys.exit(main(sys.argv[1:]))"
    arguments = ["register", "out", "--views", "front.png", "--board", "board.yaml"]
    run = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=False)
    assert run.returncode == 2
    assert run.stderr == (
        "kinran register: the package pycolmap is missing, which registers views: pip install 'pycolmap>=4.2'\n"
    )


def test_cameras_file(registered: Path, session: Session) -> None:
    described = json.loads((registered / "cameras.json").read_text())
    assert described["first_pixel_centre"] == [0.5, 0.5]
    assert [view["name"] for view in described["views"]] == [view.name for view in session.views]
    for row, view in zip(described["views"], session.views, strict=True):
        rotation, translation = np.array(row["rotation"]), np.array(row["translation_mm"])
        np.testing.assert_allclose(row["centre_mm"], -rotation.T @ translation, atol=1e-9)
        np.testing.assert_allclose(row["centre_mm"], view.centre, atol=2)
        assert row["theta"] == pytest.approx(np.radians(view.theta), abs=0.02)
        assert row["rms_px"] < 0.25


def test_rectified_views_are_pictures_of_the_fabric(registered: Path, session: Session) -> None:
    """Linear light, top row first, all of the same texels: each correlates with the cloth, unmirrored and unturned."""
    texel = json.loads((registered / "register.json").read_text())["texel_mm"]
    for view in session.views:
        channels = read_exr(registered / "rectified" / f"{view.name}.exr")
        assert sorted(channels) == ["B", "G", "R"]
        green = channels["G"]
        rows, columns = np.mgrid[0 : green.shape[0], 0 : green.shape[1]] + 0.5
        x = (columns - green.shape[1] / 2) * texel
        y = (green.shape[0] / 2 - rows) * texel
        cloth = session.ground[
            np.round((y + plate.SIDE / 2) / plate.DENSE - 0.5).astype(int),
            np.round((x + plate.SIDE / 2) / plate.DENSE - 0.5).astype(int),
        ]
        dark = green < np.percentile(green, 40)  # the ground between the gold strips
        assert np.corrcoef(green[dark], cloth[dark])[0, 1] > 0.5
        assert np.corrcoef(green[::-1][dark[::-1]], cloth[dark[::-1]])[0, 1] < 0.1
        assert green[dark].mean() == pytest.approx(cloth[dark].mean(), rel=0.25)  # linear, at the camera's exposure


def command(session: Session, files: list[Path], tmp_path: Path, field: str = "") -> None:
    main(session.inputs(files), tmp_path / "out", Options(field))


def test_views_of_different_size(session: Session, tmp_path: Path) -> None:
    cropped = tmp_path / "cropped.png"
    cropped.write_bytes(imagecodecs.png_encode(session.pictures[1][:-10]))
    with pytest.raises(InputError, match=r"cropped\.png: is 960x790, but .*front\.png is 960x800"):
        command(session, [*session.files[:3], cropped], tmp_path)


def test_view_without_the_board(session: Session, tmp_path: Path) -> None:
    blank = tmp_path / "blank.png"
    blank.write_bytes(imagecodecs.png_encode(np.full_like(session.pictures[0], 90)))
    with pytest.raises(InputError, match=r"blank\.png: the board is not found"):
        command(session, [*session.files[:2], blank], tmp_path)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("field", "message"),
    [("60,60", "inside the opening of 50 x 50 mm"), ("45", "give W,H"), ("0,20", "inside"), ("nan,4", "inside")],
)
def test_wrong_field(session: Session, tmp_path: Path, field: str, message: str) -> None:
    with pytest.raises(InputError, match=f"field '{field}': .*{message}"):
        command(session, session.files, tmp_path, field)


def test_missing_view_and_view_given_twice(session: Session, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.png: no such file"):
        command(session, [*session.files[:2], tmp_path / "none.png"], tmp_path)
    with pytest.raises(InputError, match="has the same name"):
        command(session, [*session.files, session.files[1]], tmp_path)


def test_find_views(tmp_path: Path) -> None:
    for name in ("b.png", "front.jpg", "A1.tif", "notes.txt"):
        (tmp_path / name).touch()
    assert [path.name for path in find_views(tmp_path)] == ["front.jpg", "A1.tif", "b.png"]
    (tmp_path / "front.png").touch()
    with pytest.raises(InputError, match="2 pictures named front"):
        find_views(tmp_path)
    (tmp_path / "{x}.png").touch()
    with pytest.raises(InputError, match=r"\{x\}\.png: use only"):
        find_views(tmp_path)
    with pytest.raises(InputError, match="no such folder"):
        find_views(tmp_path / "none")


@pytest.mark.slow
def test_rule_is_there_only_with_the_key(session: Session, tmp_path: Path) -> None:
    config = yaml.safe_load((ROOT / "config.yaml").read_text())
    (tmp_path / "config").mkdir()
    for sheet in ("fabrics", "recapture"):
        (tmp_path / "config" / f"{sheet}.tsv").write_text((ROOT / "config" / f"{sheet}.tsv").read_text())

    def rules(more: dict[str, object]) -> str:
        (tmp_path / "config.yaml").write_text(yaml.safe_dump({**config, **more}))
        arguments = ["--list-rules"] if not more else ["--dry-run", "register"]
        call = [sys.executable, "-m", "snakemake", "--snakefile", str(ROOT / "Snakefile"), "--cores", "1", *arguments]
        done = subprocess.run(call, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout + done.stderr

    assert "register" not in rules({}).split()
    shown = rules({"register": {"views": str(session.folder), "board": str(session.folder / "board.yaml")}})
    assert "results/register/rectified/t60p20.exr" in shown
