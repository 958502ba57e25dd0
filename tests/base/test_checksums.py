"""Checksums inside files: every flipped bit is told, and no reader of the content is disturbed."""

import io
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from kinran.base.checksums import comment
from kinran.base.files import InputError, check_comment, read_json, write_json
from kinran.base.npz import read_npz
from kinran.base.pictures import check_png


def flipped(path: Path, read: Callable[[Path], object], step: int = 1) -> tuple[int, list[int]]:
    """Number of flipped bits that raise an error with the file's name, and those that are read as something else."""
    whole, sound = path.read_bytes(), repr(read(path))
    named, silent = 0, []
    for bit in range(0, 8 * len(whole), step):
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        path.write_bytes(damaged)
        try:
            if repr(read(path)) != sound:
                silent.append(bit)
        except InputError as error:
            named += path.name in str(error)
    path.write_bytes(whole)
    return named, silent


@pytest.mark.parametrize("value", [{"α": 1.25, "β": [None, True]}, [{"label": 0, "name": "gold"}], 7])
def test_json_with_a_flipped_bit_is_an_error(tmp_path: Path, value: object) -> None:
    """But in the line of the checksum a tab that becomes a carriage return, which leaves the content alone."""
    path = tmp_path / "a.json"
    write_json(path, value)
    named, silent = flipped(path, read_json)
    assert silent == []
    assert named >= 8 * path.stat().st_size - 32


def test_without_a_checksum_most_flips_of_a_number_are_silent(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"values": [0.123456789012345] * 9}))
    assert len(flipped(path, read_json)[1]) > 100


def test_other_programs_read_the_json_as_it_was(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", [{"label": 0}])
    text = (tmp_path / "a.json").read_text()
    assert json.loads(text) == [{"label": 0}]
    assert text.strip() == json.dumps([{"label": 0}], indent=1)


def test_edited_json_names_the_way_out(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    write_json(path, {"camera": 1})
    lines = path.read_text().replace("1", "2").splitlines()
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match=r"a\.json: does not match its checksum; .* delete its last line"):
        read_json(path)
    path.write_text("\n".join(lines[:-1]) + "\n")
    assert read_json(path) == {"camera": 2}


@pytest.mark.parametrize("rest", [b"<scene>1.5</scene>\n", bytes(range(256))])
def test_a_comment_covers_all_other_lines(tmp_path: Path, rest: bytes) -> None:
    path, start = tmp_path / "a.ply", b"ply\nformat\n"

    def read(path: Path) -> bytes:
        check_comment(path)
        lines = path.read_bytes().split(b"\n")
        return b"\n".join(line for line in lines if not line.startswith(b"comment"))

    path.write_bytes(start + f"comment {comment(start, rest)}\n".encode() + rest)
    named, _ = flipped(path, read)
    assert named >= 8 * (path.stat().st_size - len("comment kinran:crc32 "))
    path.write_bytes(start + rest)
    check_comment(path)


def test_arrays_with_a_flipped_bit_are_an_error_or_the_same(tmp_path: Path) -> None:
    """`numpy.load` itself reads some of them as arrays of another shape."""
    path = tmp_path / "a.npz"
    np.savez(path, a=np.arange(6.0).reshape(2, 3), kind="slope")
    named, silent = flipped(path, lambda path: {name: array.tobytes() for name, array in read_npz(path).items()})
    assert silent == []
    assert named > 8 * 2 * 128


def test_a_png_with_a_flipped_bit_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    buffer = io.BytesIO()
    Image.fromarray(np.arange(48, dtype=np.uint8).reshape(4, 4, 3)).save(buffer, "PNG")
    path.write_bytes(buffer.getvalue())
    named, silent = flipped(path, check_png)
    assert silent == []
    assert named >= 8 * (path.stat().st_size - 12)  # its last part says that the file ends
