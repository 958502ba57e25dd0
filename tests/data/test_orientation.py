"""The eight orientations: photographs of any kind lie in memory as they are shown, and so do their crops and sizes."""

from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image, ImageOps
from raw_frames import write

from kinran.base.encoding import parse
from kinran.base.files import InputError
from kinran.bracket.shots import Frame, Taken, read_bracket
from kinran.capture.photograph_set import check_orientation
from kinran.data.orientation import upright
from kinran.data.photographs import Crop, orientation, read, size
from kinran.data.raw import read_raw

LINEAR = parse("linear")
STORED = np.random.default_rng(3).integers(0, 250, (24, 40, 3), dtype=np.uint8)
SHOWN = {
    1: STORED,
    2: STORED[:, ::-1],
    3: STORED[::-1, ::-1],
    4: STORED[::-1],
    5: STORED.swapaxes(0, 1),
    6: np.rot90(STORED, -1),
    7: np.rot90(STORED[:, ::-1], -1),
    8: np.rot90(STORED, 1),
}
"""What a picture looks like, by EXIF: in 6, row 0 is the visual right side, and column 0 the visual top."""


def store(path: Path, code: int) -> Path:
    """Write the picture with an orientation."""
    if path.suffix == ".tif":
        tifffile.imwrite(path, STORED, photometric="rgb", extratags=[(274, "H", 1, code, True)])
        return path
    exif = Image.Exif()
    exif[274] = code
    smooth = {"quality": 100, "subsampling": 0} if path.suffix == ".jpg" else {}
    Image.fromarray(STORED).save(path, exif=exif, **smooth, **({"lossless": True} if path.suffix == ".webp" else {}))
    return path


@pytest.mark.parametrize("code", SHOWN)
@pytest.mark.parametrize("suffix", ["jpg", "png", "tif", "webp"])
def test_a_photograph_is_read_as_it_is_shown(tmp_path: Path, suffix: str, code: int) -> None:
    path = store(tmp_path / f"a.{suffix}", code)
    shown = SHOWN[code]
    found = read(path, LINEAR).value[::-1] * 255
    np.testing.assert_allclose(found, shown, atol=12 if suffix == "jpg" else 0.01)
    with Image.open(path) as image:  # as another program shows it
        assert ImageOps.exif_transpose(image).size == size(path) == shown.shape[1::-1]
    corner = read(path, LINEAR, Crop(3, 5, 7, 6)).value[::-1] * 255
    np.testing.assert_allclose(corner, found[5:11, 3:10], atol=1e-3)
    assert orientation(path) == code


@pytest.mark.parametrize("code", SHOWN)
def test_a_raw_file_is_turned_as_a_photograph_is(tmp_path: Path, code: int) -> None:
    counts = np.kron(STORED[..., 0].astype(np.uint16) * 10 + 300, np.ones((2, 2), np.uint16))
    path = write(tmp_path / "a.dng", counts, 100, orientation=code)
    shown = SHOWN[code][..., 0]
    assert size(path) == shown.shape[::-1]
    assert orientation(path) == code
    for plane in read_raw(path).upright().planes:
        np.testing.assert_array_equal((plane[::-1] - 300) // 10, shown)


def test_an_unknown_orientation_is_upright() -> None:
    np.testing.assert_array_equal(upright(STORED, 9), STORED)


def test_a_set_of_mixed_orientations_is_refused(tmp_path: Path) -> None:
    paths = [store(tmp_path / f"{k}.png", code) for k, code in enumerate((3, 3, 1))]
    check_orientation(paths[:2])
    with pytest.raises(InputError, match=r"2\.png: is shown in orientation 1 of EXIF but 0\.png in 3; .*lights"):
        check_orientation(paths)


@pytest.mark.parametrize("code", [1, 2, 6])
def test_raw_frames_of_a_set_are_turned_and_then_cut_and_those_of_the_rig_are_not(tmp_path: Path, code: int) -> None:
    counts = np.kron(STORED[..., 0].astype(np.uint16) * 10 + 300, np.ones((2, 2), np.uint16))
    path = write(tmp_path / "a.dng", counts, 100, orientation=code)
    shot = Taken("a", "light", 0, None, None, (Frame(path, 0.01),))
    of_set = read_bracket(shot, LINEAR, Crop(3, 5, 7, 6)).planes[0, 0]
    np.testing.assert_array_equal((of_set[::-1] - 300) // 10, SHOWN[code][5:11, 3:10, 0])
    of_rig = read_bracket(shot).planes[0, 0]
    np.testing.assert_array_equal((of_rig[::-1] - 300) // 10, STORED[..., 0])
