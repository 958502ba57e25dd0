"""The radiance stack: the merged photographs of a fabric, as a Zarr v3 group.

Its arrays are `radiance` float16 and `flags` uint8, both (light, y, x, channel); row 0 is v = 0. One shard holds 8
lights, so that a merge job writes whole files. `write_shards` writes the shards of a group, `write_metadata` the
metadata that complete the stack. Each chunk ends with its CRC-32C, which Zarr checks when it reads the chunk, and each
file of metadata with the checksum of `write_json`.
"""

import math
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinran.base.checksums import json_line
from kinran.base.files import InputError, atomic, on_disk, read_json
from kinran.data.light import Light as Light
from kinran.data.radiance import HOT, OUTSIDE, SATURATED, Flags, Radiance
from kinran.data.shard_file import CHUNK as CHUNK
from kinran.data.shard_file import Box as Box
from kinran.data.shard_file import as_declared, read_box, write_shard
from kinran.data.shards import NAMES, SHARD, shard_path

LARGEST = float(np.finfo(np.float16).max)
"""Largest value that a stack holds."""


@dataclass(frozen=True)
class Metadata:
    """Metadata of a radiance stack.

    Attributes
    ----------
    lights
        Lights in the order of the stack.
    height, width
        Size in texels.
    texel_mm
        Side of a texel in millimetres; None when unknown.
    encoding
        Encoding of the photographs that the stack was made of; empty for merged brackets.
    crop
        ``X,Y,W,H`` of the photographs that was used; empty for all.
    colour
        Name of the stack's RGB.
    to_acescg : (3, 3) float
        Stack RGB (column) to linear ACEScg.
    noise
        Parameters of the noise model.
    camera_mm
        Position of the camera's centre of projection in millimetres from the field's centre; None when unknown.
    masked
        Whether the set has a mask, so that texels outside it are flagged (`OUTSIDE`).
    """

    lights: tuple[Light, ...]
    height: int
    width: int
    texel_mm: float | None
    encoding: str
    crop: str
    colour: str
    to_acescg: NDArray[np.float64]
    noise: dict[str, Any]
    camera_mm: tuple[float, float, float] | None = None
    masked: bool = False


@dataclass(frozen=True, kw_only=True)
class Stack(Metadata):
    """A radiance stack on disk.

    Attributes
    ----------
    path
        Folder of the stack.
    unit
        Meaning of a value of 1.
    """

    path: Path
    unit: str
    _ours: frozenset[str]

    @classmethod
    def open(cls, path: Path) -> "Stack":
        """Open a stack.

        Raises
        ------
        InputError
            The folder is not a stack, or its metadata are damaged.
        """
        if not (path / "zarr.json").is_file():
            raise InputError(f"{path}: is no radiance stack; make it with `kinran stack`")
        group, *arrays = (read_json(path / name / "zarr.json") for name in (".", *NAMES))
        try:
            values: dict[str, Any] = group["attributes"]
            lights = msgspec.convert(values["lights"], tuple[Light, ...])
            size = (values["height"], values["width"])
            if any(array["shape"] != [len(lights), *size, 3] for array in arrays):
                raise ValueError("its arrays do not have the shape of its lights")
            return cls(
                lights=lights,
                **{name: values[name] for name in ("height", "width", "texel_mm", "encoding", "crop", "noise", "unit")},
                colour=values["colour"]["name"],
                to_acescg=np.array(values["colour"]["to_acescg"], float).reshape(3, 3),
                camera_mm=msgspec.convert(values.get("camera_mm"), tuple[float, float, float] | None),
                masked=values.get("masked", False),
                path=path,
                _ours=frozenset(name for name, array in zip(NAMES, arrays, strict=True) if as_declared(array, size)),
            )
        except (KeyError, ValueError, TypeError) as error:
            raise InputError(f"{path}: is damaged ({error}); make it again with `kinran stack`") from None

    @property
    def held_out(self) -> NDArray[np.bool_]:
        """Whether each light (light,) is held out."""
        return np.array([light.held_out for light in self.lights], bool)

    @property
    def directions(self) -> NDArray[np.float64]:
        """Unit directions (light, 3) of the lights."""
        return np.array([light.direction for light in self.lights], float).reshape(-1, 3)

    @cached_property
    def inside(self) -> NDArray[np.bool_]:
        """Whether each texel (y, x) is inside the mask of the set; all are where it has none."""
        inside = np.ones((self.height, self.width), bool)
        for y0, y1, x0, x1 in self.tiles() if self.masked else []:
            _, flags = self.read_stored(y0, y1, x0, x1, lights=[0])
            inside[y0:y1, x0:x1] = ~((flags[0] & OUTSIDE) > 0).any(-1)
        return inside

    def tiles(self, side: int = CHUNK) -> list[Box]:
        """Return boxes (y0, y1, x0, x1) that cover the stack, in rows from v = 0; chunks by default."""
        return [
            (y, min(y + side, self.height), x, min(x + side, self.width))
            for y in range(0, self.height, side)
            for x in range(0, self.width, side)
        ]

    def read_tile(self, y0: int, y1: int, x0: int, x1: int, lights: ArrayLike | None = None) -> Radiance:
        """Read the radiance (light, y, x, 3) of a tile under all lights, or under the lights of these indices.

        Raises
        ------
        InputError
            A shard is missing or damaged.
        """
        values, flags = self.read_stored(y0, y1, x0, x1, lights)
        return Radiance(values.astype(np.float32), flags)

    def read_stored(
        self, y0: int, y1: int, x0: int, x1: int, lights: ArrayLike | None = None
    ) -> tuple[NDArray[np.float16], Flags]:
        """Read values, in half precision as stored, and flags; parameters and errors as in `read_tile`."""
        use = np.arange(len(self.lights)) if lights is None else np.asarray(lights, np.intp)
        for name, shard in product(NAMES, np.unique(use // SHARD).tolist()):
            if not shard_path(self.path, name, shard).is_file():
                raise InputError(f"{shard_path(self.path, name, shard)}: is missing; merge its group")
        box = (y0, y1, x0, x1)
        return self._read("radiance", np.float16, use, box), self._read("flags", np.uint8, use, box)

    def _read(self, name: str, kind: type[np.generic], lights: NDArray[np.intp], box: Box) -> NDArray[Any]:
        """Read an array under these lights in a box."""
        y0, y1, x0, x1 = box
        out = np.empty((len(lights), y1 - y0, x1 - x0, 3), kind)
        for shard in np.unique(lights // SHARD).tolist():
            path, at = shard_path(self.path, name, shard), np.flatnonzero(lights // SHARD == shard)
            try:
                if name in self._ours:
                    out[at] = read_box(path, np.dtype(kind), (self.height, self.width), box, lights[at] % SHARD)
                else:
                    out[at] = self._zarr[name][shard * SHARD : (shard + 1) * SHARD, y0:y1, x0:x1][lights[at] % SHARD]
            except Exception as error:  # codecs raise errors of any kind on a broken shard
                raise InputError(
                    f"{path}: is damaged ({error}); delete it, and snakemake merges its group again"
                ) from None
        return out

    @cached_property
    def _zarr(self) -> Any:
        """The stack by Zarr itself, which reads what other programs wrote."""
        import zarr

        return zarr.open_group(self.path, mode="r")


def write_shards(folder: Path, first: int, radiance: Radiance) -> list[Path]:
    """Write the shards of neighbouring lights, each file whole.

    Parameters
    ----------
    folder
        The stack.
    first
        Index of the first light, a multiple of 8.
    radiance : (light, y, x, 3)
        Radiance in the stack's unit. Values over the range of float16 are clipped to it and flagged as saturated;
        values that are not finite become 0 and are flagged as hot.

    Returns
    -------
    list of Path
        Files that were written.
    """
    shape, of_flags = radiance.value.shape, radiance.flags.shape
    if first % SHARD or shape != of_flags or len(shape) != 4 or shape[-1] != 3:
        raise ValueError(f"{shape} and {of_flags} from light {first} are no whole shards")
    with ShardWriter(folder, shape[1], shape[2]) as writer:
        for k in range(shape[0]):
            writer.add(radiance[k])
        return writer.write(first)


class ShardWriter:
    """Writer of the shards of neighbouring lights, which takes their pictures one by one.

    The pictures go to a scratch file beside the stack, so that only one is in memory.
    """

    def __init__(self, folder: Path, height: int, width: int) -> None:
        self._folder, self._size, self._lights = folder, (height, width), 0
        self._context = _scratch(folder)

    def __enter__(self) -> "ShardWriter":
        self._scratch = self._context.__enter__()
        self._files = {name: (self._scratch / f"{name}.raw").open("wb") for name in NAMES}
        return self

    def __exit__(self, *error: Any) -> None:
        for file in self._files.values():
            with suppress(OSError):  # it was not to be kept, or `write` has closed it
                file.close()
        self._context.__exit__(*error)

    def add(self, picture: Radiance) -> None:
        """Add a picture (y, x, 3), whose values are clipped as in `write_shards`."""
        shape, of_flags = picture.value.shape, picture.flags.shape
        if shape != (*self._size, 3) or of_flags != shape:
            raise ValueError(f"{shape} and {of_flags} are no pictures of {self._size}")
        with on_disk(self._folder):
            for first in range(0, len(picture.value), CHUNK):
                half, bits = _half(picture[first : first + CHUNK])
                self._files["radiance"].write(half.tobytes())
                self._files["flags"].write(bits.tobytes())
        self._lights += 1

    def write(self, first: int) -> list[Path]:
        """Write the shards, of which `first` is the first light; return the files."""
        with on_disk(self._folder):
            return self._write(first)

    def _write(self, first: int) -> list[Path]:
        shape = (self._lights, *self._size, 3)
        written = []
        for name, dtype in zip(NAMES, ("float16", "uint8"), strict=True):
            self._files[name].close()
            raw = self._scratch / f"{name}.raw"
            for k in range(0, self._lights, SHARD):
                write_shard(shard_path(self._scratch, name, k // SHARD), raw, dtype, shape, k)
            raw.unlink()
        for name in NAMES:
            for k in range(-(-self._lights // SHARD)):
                path = shard_path(self._folder, name, first // SHARD + k)
                path.parent.mkdir(parents=True, exist_ok=True)
                shard_path(self._scratch, name, k).replace(path)
                written.append(path)
        return written


def _half(radiance: Radiance) -> tuple[NDArray[np.float16], Flags]:
    """Return values as float16, clipped to its range, and flags that mark those outside."""
    values, flags = np.asarray(radiance.value, np.float32), radiance.flags
    finite = np.isfinite(values)
    over = np.abs(values) > LARGEST
    bits = flags | np.where(finite, 0, HOT).astype(np.uint8) | np.where(finite & over, SATURATED, 0).astype(np.uint8)
    return np.clip(np.where(finite, values, 0), -LARGEST, LARGEST).astype(np.float16), bits


def write_metadata(folder: Path, metadata: Metadata) -> None:
    """Write the metadata that complete a stack, after its shards."""
    attributes = {
        "lights": [asdict(light) for light in metadata.lights],
        "height": metadata.height,
        "width": metadata.width,
        "texel_mm": metadata.texel_mm,
        "encoding": metadata.encoding,
        "crop": metadata.crop,
        "colour": {"name": metadata.colour, "to_acescg": np.asarray(metadata.to_acescg, float).tolist()},
        "noise": metadata.noise,
        "camera_mm": metadata.camera_mm,
        "unit": unit_of(metadata.encoding, metadata.noise),
        **({"masked": True} if metadata.masked else {}),
    }
    import zarr

    with _scratch(folder) as scratch, on_disk(folder):
        zarr.create_group(scratch, attributes=attributes)
        shape = (len(metadata.lights), metadata.height, metadata.width, 3)
        for name, dtype in zip(NAMES, ("float16", "uint8"), strict=True):
            _create(scratch, name, shape, dtype)
        for name in (*NAMES, "."):  # the group last: it completes the stack
            body = (scratch / name / "zarr.json").read_bytes() + b"\n"
            with atomic(folder / name / "zarr.json") as temporary:
                temporary.write_bytes(body + json_line(body))


@contextmanager
def _scratch(folder: Path) -> Iterator[Path]:
    """Make a temporary folder on the same disk, so that its files can be renamed into `folder`."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=".part-", dir=folder))
    except OSError as error:
        raise InputError(f"{folder}: cannot be written to ({error.strerror}); choose another output folder") from None
    try:
        yield scratch
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _create(folder: Path, name: str, shape: tuple[int, ...], dtype: str) -> Any:
    import zarr
    from zarr.codecs import BloscCodec, Crc32cCodec

    height, width = (CHUNK * math.ceil(side / CHUNK) for side in shape[1:3])
    return zarr.create_array(
        store=folder,
        name=name,
        shape=shape,
        dtype=dtype,
        chunks=(SHARD, CHUNK, CHUNK, 3),
        shards=(SHARD, height, width, 3),
        compressors=[BloscCodec(cname="zstd", clevel=3, shuffle="bitshuffle"), Crc32cCodec()],
        fill_value=0,
        dimension_names=("light", "y", "x", "channel"),
        config={"write_empty_chunks": True},
    )


def unit_of(encoding: str, noise: dict[str, Any]) -> str:
    """Return the meaning of a value of 1 in a stack of this encoding and noise model."""
    if encoding:
        return "1 is the encoding's white"
    if noise.get("white") == "longest exposure":
        return "1 is white at the longest exposure"
    return "pi T: a white diffuser that faces the lamp is 1"
