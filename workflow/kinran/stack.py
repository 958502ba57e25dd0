"""The radiance stack: what the merged photographs of a fabric say, as a Zarr v3 group.

`radiance` float16 and `flags` uint8, both (light, y, x, channel), row 0 is v = 0. One shard holds 8 lights,
so that a merge job writes whole files: `write_shards` those of a group, `write_metadata` what makes them a
stack.
"""

import math
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinran.files import InputError, atomic
from kinran.lights import Light as Light

Image = NDArray[np.float32]
Flags = NDArray[np.uint8]
Box = tuple[int, int, int, int]

SATURATED, DARK, HOT, SHIFTED = 1, 2, 4, 8
"""Bits of `flags`: no exposure was under saturation (the value is a lower bound); under three standard
deviations of its noise; a defect of the sensor; the frame had moved."""

SHARD, CHUNK = 8, 64
LARGEST = float(np.finfo(np.float16).max)
NAMES = ("radiance", "flags")


@dataclass(frozen=True)
class Stack:
    """A radiance stack that can be read.

    Attributes
    ----------
    path
        Folder.
    lights
        In the order of the stack.
    height, width
        In texels.
    texel_mm
        Side of a texel; None when unknown.
    encoding
        Of the photographs that the stack was made of; empty for a stack of RAW frames, whose unit is π·T.
    crop
        ``X,Y,W,H`` of the photographs that was used; empty for all.
    colour
        Name of the stack's RGB.
    to_acescg : (3, 3) float
        Stack RGB (column) to linear ACEScg.
    noise
        Parameters of the noise model.
    unit
        What 1 means.
    camera_mm
        Where the camera's centre stands, from the field's centre; None when unknown.
    """

    path: Path
    lights: tuple[Light, ...]
    height: int
    width: int
    texel_mm: float | None
    encoding: str
    crop: str
    colour: str
    to_acescg: NDArray[np.float64]
    noise: dict[str, Any]
    unit: str
    camera_mm: tuple[float, float, float] | None
    _arrays: tuple[Any, Any]

    @classmethod
    def open(cls, path: Path) -> "Stack":
        """Open a stack.

        Raises
        ------
        InputError
            It is not there, or its metadata is not that of a stack.
        """
        import zarr

        if not (path / "zarr.json").is_file():
            raise InputError(f"{path}: is no radiance stack; make it with `kinran stack`")
        try:
            group = zarr.open_group(path, mode="r")
            values: dict[str, Any] = dict(group.attrs)
            lights = msgspec.convert(values["lights"], tuple[Light, ...])
            arrays = group["radiance"], group["flags"]
            shape = (len(lights), values["height"], values["width"], 3)
            if any(getattr(array, "shape", None) != shape for array in arrays):
                raise ValueError("its arrays do not have the shape of its lights")
            return cls(
                path,
                lights,
                values["height"],
                values["width"],
                values["texel_mm"],
                values["encoding"],
                values["crop"],
                values["colour"]["name"],
                np.array(values["colour"]["to_acescg"], float).reshape(3, 3),
                values["noise"],
                values["unit"],
                msgspec.convert(values.get("camera_mm"), tuple[float, float, float] | None),
                arrays,
            )
        except (KeyError, ValueError, TypeError) as error:
            raise InputError(f"{path}: is damaged ({error}); make it again with `kinran stack`") from None

    @property
    def held_out(self) -> NDArray[np.bool_]:
        """(light,) whether each light is held out."""
        return np.array([light.held_out for light in self.lights], bool)

    @property
    def directions(self) -> NDArray[np.float64]:
        """(light, 3) unit vectors."""
        return np.array([light.direction for light in self.lights], float).reshape(-1, 3)

    def tiles(self, side: int = CHUNK) -> list[Box]:
        """Boxes (y0, y1, x0, x1) that cover the stack, in rows from v = 0; chunks by default."""
        return [
            (y, min(y + side, self.height), x, min(x + side, self.width))
            for y in range(0, self.height, side)
            for x in range(0, self.width, side)
        ]

    def read_tile(self, y0: int, y1: int, x0: int, x1: int, lights: ArrayLike | None = None) -> tuple[Image, Flags]:
        """Read a tile under all lights, or under those of these indices.

        Returns
        -------
        radiance : (light, y, x, 3) float32
        flags : (light, y, x, 3) uint8

        Raises
        ------
        InputError
            A shard is missing or damaged.
        """
        radiance, flags = self.read_stored(y0, y1, x0, x1, lights)
        return radiance.astype(np.float32), flags

    def read_stored(
        self, y0: int, y1: int, x0: int, x1: int, lights: ArrayLike | None = None
    ) -> tuple[NDArray[np.float16], Flags]:
        """`read_tile` in half precision, as it lies in the stack."""
        use = np.arange(len(self.lights)) if lights is None else np.asarray(lights, np.intp)
        for name, shard in product(NAMES, np.unique(use // SHARD).tolist()):
            if not shard_path(self.path, name, shard).is_file():
                raise InputError(f"{shard_path(self.path, name, shard)}: is missing; merge its group")
        # whole chunks of 8 lights are decoded in any case: read the run of them, then take what is asked for
        first, last = (use.min() // SHARD * SHARD, use.max() + 1) if use.size else (0, 0)
        try:
            radiance, flags = (array[first:last, y0:y1, x0:x1] for array in self._arrays)
        except Exception as error:  # Zarr and its codecs raise what they like on a broken shard
            raise InputError(f"{self.path}: a shard is damaged ({error}); merge its group again") from None
        return np.asarray(radiance, np.float16)[use - first], np.asarray(flags, np.uint8)[use - first]


def shard_path(folder: Path, name: str, shard: int) -> Path:
    """File of a shard of the array ``radiance`` or ``flags``."""
    return folder / name / "c" / str(shard) / "0" / "0" / "0"


def group_shards(lights: Sequence[int], last: int | None) -> list[int]:
    """Shards that a group's merge writes: whole ones, but for the one with the light `last` at θ = 0.

    The light at θ = 0 has shots in all groups, so that its shard is written when the stack is put together.

    Parameters
    ----------
    lights
        Indices of the group's lights.
    last
        Index of the light at θ = 0; None for photographs.
    """
    shards = sorted({index // SHARD for index in lights})
    return [shard for shard in shards if last is None or shard != last // SHARD]


def write_shards(folder: Path, first: int, radiance: Image, flags: Flags) -> list[Path]:
    """Write the shards of neighbouring lights; each file appears whole.

    Parameters
    ----------
    folder
        The stack.
    first
        Index of the first light, a multiple of 8.
    radiance : (light, y, x, 3) float
        Values over the range of float16 are cut to it and flagged as saturated; what is not finite becomes 0,
        flagged as hot.
    flags : (light, y, x, 3) uint8

    Returns
    -------
    list of Path
        The files.
    """
    if first % SHARD or radiance.shape != flags.shape or radiance.ndim != 4 or radiance.shape[-1] != 3:
        raise ValueError(f"{radiance.shape} and {flags.shape} from light {first} are no whole shards")
    with ShardWriter(folder, radiance.shape[1], radiance.shape[2]) as writer:
        for picture, bits in zip(radiance, flags, strict=True):
            writer.add(picture, bits)
        return writer.write(first)


class ShardWriter:
    """Takes the pictures of neighbouring lights one after the other, then writes their shards.

    What it is given goes to a scratch file beside the stack, so that a picture is all that it holds in memory.
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
            file.close()
        self._context.__exit__(*error)

    def add(self, radiance: Image, flags: Flags) -> None:
        """Add a picture (y, x, 3); values as of `write_shards`."""
        if radiance.shape != (*self._size, 3) or flags.shape != radiance.shape:
            raise ValueError(f"{radiance.shape} and {flags.shape} are no pictures of {self._size}")
        for first in range(0, len(radiance), CHUNK):
            rows = slice(first, first + CHUNK)
            half, bits = _half(radiance[rows], flags[rows])
            self._files["radiance"].write(half.tobytes())
            self._files["flags"].write(bits.tobytes())
        self._lights += 1

    def write(self, first: int) -> list[Path]:
        """Write the shards, of which `first` is the first light; returns the files."""
        shape = (self._lights, *self._size, 3)
        written = []
        for name, dtype in zip(NAMES, ("float16", "uint8"), strict=True):
            self._files[name].close()
            raw = self._scratch / f"{name}.raw"
            _create(self._scratch, name, shape, dtype)[:] = np.memmap(raw, dtype, "r", shape=shape)
            raw.unlink()
        for name in NAMES:
            for k in range(-(-self._lights // SHARD)):
                path = shard_path(self._folder, name, first // SHARD + k)
                path.parent.mkdir(parents=True, exist_ok=True)
                shard_path(self._scratch, name, k).replace(path)
                written.append(path)
        return written


def _half(radiance: Image, flags: Flags) -> tuple[NDArray[np.float16], Flags]:
    """Values as float16 within its range, with flags for those that are outside."""
    values = np.asarray(radiance, np.float32)
    finite = np.isfinite(values)
    over = np.abs(values) > LARGEST
    bits = flags | np.where(finite, 0, HOT).astype(np.uint8) | np.where(finite & over, SATURATED, 0).astype(np.uint8)
    return np.clip(np.where(finite, values, 0), -LARGEST, LARGEST).astype(np.float16), bits


def write_metadata(
    folder: Path,
    lights: Sequence[Light],
    height: int,
    width: int,
    texel_mm: float | None,
    encoding: str,
    crop: str,
    colour: str,
    to_acescg: ArrayLike,
    noise: dict[str, Any],
    camera_mm: tuple[float, float, float] | None = None,
) -> None:
    """Write what makes shards a stack; parameters as the attributes of `Stack`."""
    attributes = {
        "lights": [asdict(light) for light in lights],
        "height": height,
        "width": width,
        "texel_mm": texel_mm,
        "encoding": encoding,
        "crop": crop,
        "colour": {"name": colour, "to_acescg": np.asarray(to_acescg, float).tolist()},
        "noise": noise,
        "camera_mm": camera_mm,
        "unit": unit_of(encoding, noise),
    }
    import zarr

    with _scratch(folder) as scratch:
        zarr.create_group(scratch, attributes=attributes)
        shape = (len(lights), height, width, 3)
        for name, dtype in zip(NAMES, ("float16", "uint8"), strict=True):
            _create(scratch, name, shape, dtype)
        for name in (*NAMES, "."):  # the group last: with it the stack is there
            with atomic(folder / name / "zarr.json") as temporary:
                shutil.copyfile(scratch / name / "zarr.json", temporary)


@contextmanager
def _scratch(folder: Path) -> Iterator[Path]:
    """A temporary folder on the same disk, so that its files can be renamed into `folder`."""
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
    from zarr.codecs import BloscCodec

    height, width = (CHUNK * math.ceil(side / CHUNK) for side in shape[1:3])
    return zarr.create_array(
        store=folder,
        name=name,
        shape=shape,
        dtype=dtype,
        chunks=(SHARD, CHUNK, CHUNK, 3),
        shards=(SHARD, height, width, 3),
        compressors=BloscCodec(cname="zstd", clevel=3, shuffle="bitshuffle"),
        fill_value=0,
        dimension_names=("light", "y", "x", "channel"),
        config={"write_empty_chunks": True},
    )


def unit_of(encoding: str, noise: dict[str, Any]) -> str:
    """What 1 means in a stack."""
    if encoding:
        return "1 is the encoding's white"
    if noise.get("white") == "longest exposure":
        return "1 is white at the longest exposure"
    return "pi T: a white diffuser that faces the lamp is 1"
