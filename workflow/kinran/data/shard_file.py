"""The file of a shard: chunks of 8 lights by 64 × 64 texels, each with its CRC-32C, then the index of their places.

It is Zarr v3's codec ``sharding_indexed``, as the metadata of a stack declare it, and Zarr itself reads these files.
But each stage reads the whole stack, tile by tile, and Zarr takes four times the processor time for it (docs/fit.md,
"Speed"); and to write a shard it holds all chunks of it.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from kinran.data.shards import SHARD

CHUNK = 64
"""Side of a chunk in texels: a fit reads one chunk at a time."""
PLACE = np.dtype("<u8")
"""Number of the index, which has the place and the length of each chunk in bytes."""
CHECKSUM = 4
"""Bytes of a checksum."""

Box = tuple[int, int, int, int]


def as_declared(metadata: dict[str, Any], size: tuple[int, int]) -> bool:
    """Return whether the metadata of an array (Zarr v3) say that its shards are files of this kind.

    Parameters
    ----------
    metadata
        Contents of its ``zarr.json``.
    size
        Height and width of the stack.
    """
    try:
        (codec,) = metadata["codecs"]
        inner = codec["configuration"]
        stored, packed, summed = inner["codecs"]
        endian = stored.get("configuration", {}).get("endian", "little")
        return bool(
            metadata["data_type"] in ("float16", "uint8")
            and metadata["chunk_grid"]["configuration"]["chunk_shape"] == [SHARD, *_whole(size), 3]
            and codec["name"] == "sharding_indexed"
            and inner["chunk_shape"] == [SHARD, CHUNK, CHUNK, 3]
            and inner["index_location"] == "end"
            and [part["name"] for part in inner["index_codecs"]] == ["bytes", "crc32c"]
            and (stored["name"], endian, packed["name"], summed["name"]) == ("bytes", "little", "blosc", "crc32c")
        )
    except (KeyError, TypeError, ValueError):
        return False


def read_box(
    path: Path, dtype: np.dtype[Any], size: tuple[int, int], box: Box, lights: NDArray[np.intp]
) -> NDArray[Any]:
    """Read a box (light, y, x, 3) of some lights of a shard.

    Parameters
    ----------
    path
        File of the shard.
    dtype
        Type of its values: float16 or uint8.
    size
        Height and width of the stack.
    box
        First and last row (exclusive), first and last column.
    lights
        Indices of the lights, from 0 to 7.

    Raises
    ------
    OSError, ValueError
        The file cannot be read; a checksum contradicts it.
    """
    y0, y1, x0, x1 = box
    across = -(-size[1] // CHUNK)
    out = np.empty((len(lights), y1 - y0, x1 - x0, 3), dtype)
    with path.open("rb") as file:
        index = _index(file, size)
        for row in range(y0 // CHUNK, -(-y1 // CHUNK)):
            for column in range(x0 // CHUNK, -(-x1 // CHUNK)):
                place, length = index[row * across + column].tolist()
                chunk = _chunk(file, place, length, dtype)
                top, left = row * CHUNK, column * CHUNK
                rows = slice(max(y0, top), min(y1, top + CHUNK))
                columns = slice(max(x0, left), min(x1, left + CHUNK))
                part = chunk[lights, rows.start - top : rows.stop - top, columns.start - left : columns.stop - left]
                out[:, rows.start - y0 : rows.stop - y0, columns.start - x0 : columns.stop - x0] = part
    return out


def _index(file: BinaryIO, size: tuple[int, int]) -> NDArray[np.uint64]:
    """Read the place and the length (chunk, 2) of each chunk."""
    height, width = _whole(size)
    count = height * width // CHUNK**2
    file.seek(-(count * 2 * PLACE.itemsize + CHECKSUM), 2)
    return np.frombuffer(_summed(file.read()), PLACE).reshape(count, 2)


def _chunk(file: BinaryIO, place: int, length: int, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Read a chunk (8, 64, 64, 3)."""
    from numcodecs import Blosc, blosc

    blosc.use_threads = False  # stages have threads of their own
    file.seek(place)
    chunk = np.frombuffer(Blosc().decode(_summed(file.read(length))), dtype)
    return chunk.reshape(SHARD, CHUNK, CHUNK, 3)


def _summed(body: bytes) -> bytes:
    """Return bytes without the CRC-32C that they end with.

    Raises
    ------
    ValueError
        It is not theirs.
    """
    import google_crc32c

    found = google_crc32c.value(body[:-CHECKSUM])
    if found.to_bytes(CHECKSUM, "little") != body[-CHECKSUM:]:
        raise ValueError("its bytes do not match their checksum")
    return body[:-CHECKSUM]


def write_shard(path: Path, raw: Path, dtype: str, shape: tuple[int, ...], first: int) -> None:
    """Write a shard of the pictures from the light `first` on in a scratch file, a row of chunks in memory at a time.

    Parameters
    ----------
    path
        File to write.
    raw
        Scratch file of all pictures of a job, one after the other.
    dtype
        ``float16`` or ``uint8``.
    shape
        Shape (light, y, x, 3) of these pictures.
    """
    import google_crc32c
    from numcodecs import Blosc

    coder = Blosc("zstd", clevel=3, shuffle=Blosc.BITSHUFFLE)
    index: list[tuple[int, int]] = []
    path.parent.mkdir(parents=True, exist_ok=True)
    with raw.open("rb") as source, path.open("wb") as file:
        for band in _bands(source, dtype, shape, first):
            for x in range(0, band.shape[2], CHUNK):
                chunk = coder.encode(np.ascontiguousarray(band[:, :, x : x + CHUNK]))
                index.append((file.tell(), len(chunk) + CHECKSUM))
                file.write(chunk + google_crc32c.value(chunk).to_bytes(CHECKSUM, "little"))
        places = np.array(index, PLACE).tobytes()
        file.write(places + google_crc32c.value(places).to_bytes(CHECKSUM, "little"))


def _bands(source: BinaryIO, dtype: str, shape: tuple[int, ...], first: int) -> Iterator[NDArray[Any]]:
    """Yield rows of chunks (8, 64, x, 3), with zeros beyond the last light, row and column."""
    lights, height, width = min(SHARD, shape[0] - first), shape[1], shape[2]
    row = width * 3 * np.dtype(dtype).itemsize
    for y in range(0, height, CHUNK):
        rows = min(CHUNK, height - y)
        band = np.zeros((SHARD, CHUNK, _whole((height, width))[1], 3), dtype)
        for k in range(lights):
            source.seek(((first + k) * height + y) * row)
            band[k, :rows, :width] = np.frombuffer(source.read(rows * row), dtype).reshape(rows, width, 3)
        yield band


def _whole(size: tuple[int, int]) -> tuple[int, int]:
    """Return height and width in whole chunks."""
    return -(-size[0] // CHUNK) * CHUNK, -(-size[1] // CHUNK) * CHUNK
