"""EXR by channel name, whatever the memory layout."""

from pathlib import Path

import numpy as np
import pytest

from kinran.exr import read_exr, read_exr_with_header, write_exr, write_rgb
from kinran.files import InputError

IMAGE = np.random.default_rng(0).random((7, 5, 3)).astype(np.float32)


@pytest.mark.parametrize(
    "image",
    [IMAGE, IMAGE[::-1], IMAGE[:, ::-1], IMAGE.transpose(1, 0, 2), np.asfortranarray(IMAGE), IMAGE[1:5, 2:4]],
    ids=["plain", "flipped", "mirrored", "transposed", "fortran", "crop"],
)
def test_no_layout_is_scrambled(tmp_path: Path, image: np.ndarray) -> None:
    write_rgb(tmp_path / "a.exr", image)
    channels = read_exr(tmp_path / "a.exr")
    np.testing.assert_array_equal(np.stack([channels[c] for c in "RGB"], -1), image)


def test_header_and_channel_names(tmp_path: Path) -> None:
    planes = {"lobe1.xx": IMAGE[..., 0], "label": IMAGE[..., 1]}
    write_exr(tmp_path / "a.exr", planes, {"kinran:model": "slope"})
    channels, header = read_exr_with_header(tmp_path / "a.exr")
    assert set(channels) == {"lobe1.xx", "label"}
    assert header["kinran:model"] == "slope"
    assert set(planes) == {"lobe1.xx", "label"}


def test_nan_and_infinity_survive(tmp_path: Path) -> None:
    plane = np.array([[np.nan, np.inf], [-1.0, 0.0]], np.float32)
    write_exr(tmp_path / "a.exr", {"Y": plane})
    np.testing.assert_array_equal(read_exr(tmp_path / "a.exr")["Y"], plane)


def test_truncated_and_missing(tmp_path: Path) -> None:
    write_rgb(tmp_path / "a.exr", IMAGE)
    whole = (tmp_path / "a.exr").read_bytes()
    (tmp_path / "b.exr").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"b\.exr: cannot be read as EXR"):
        read_exr(tmp_path / "b.exr")
    with pytest.raises(InputError, match="no such file"):
        read_exr(tmp_path / "c.exr")
