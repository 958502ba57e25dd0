"""The material file: maps of a fitted fabric in one multichannel EXR, read with Mitsuba alone, written with OpenEXR."""

import json
import logging
import os
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinran_bsdf import checksum
from kinran_bsdf.arrays import Array, Map, mi
from kinran_bsdf.models import MODELS, TAILS, Model
from kinran_bsdf.residual import Residual
from kinran_bsdf.residual import channel_names as residual_names

log = logging.getLogger(__name__)

VERSION = "1"
"""Version of the file; another one is refused."""
NEEDED = ("version", "cosine", "model", "lobes", "regions", "colour", "from_stack", "texel_mm", "source", "measured")
"""Header attributes that a file must have."""
COLOUR = "lin_ap1_scene"
"""Colour space of the maps: linear ACEScg."""
TILE = 64
"""Texels along a side of a tile of the file: as many as of a tile of a fit."""
FRAME = "X=+u=weft, Y=+v=warp, Z=view; row 0 is v=0"
"""Frame of the maps, for the header."""


@dataclass(frozen=True)
class Material:
    """Material of a fabric: its maps and their meaning.

    Attributes
    ----------
    channels
        Maps (H, W) by channel name; row 0 is v = 0, the bottom of the fabric.
    model
        Name of the model, one of `MODELS`.
    tail
        Tail of the lobes, one of `TAILS`, for a model that has tails.
    lobes
        Number of lobes: 0, 1 or 2.
    regions
        One ``{"label": int, "name": str, "model": str}`` for each region of the channel `label`, which is −1
        where nothing was measured and all other maps are 0.
    colour
        Colour space of the maps: ``lin_ap1_scene``, linear ACEScg, unclipped.
    from_stack
        (3, 3) matrix from the RGB of the radiance stack to `colour`.
    texel_mm
        Size of a texel on the fabric in mm, or None where not known.
    source
        SHA-256 of the data that were fitted, in hexadecimal.
    theta_max
        Largest θ_l of the fitted lights, in radians.
    encoding, crop
        Encoding of the fitted photographs (``srgb``, ``linear``, ``gamma:2.2``; empty for radiance) and the part
        X,Y,W,H of them that was used (empty for all), which a later comparison with them needs.
    residual
        Dependence of the maps ``residualK.RGB`` on the light; None where there is no residual.
    """

    channels: dict[str, Map]
    model: str
    tail: str
    lobes: int
    regions: list[dict[str, Any]]
    colour: str
    from_stack: Array
    texel_mm: float | None
    source: str
    theta_max: float
    encoding: str = ""
    crop: str = ""
    residual: Residual | None = None

    @cached_property
    def reflection(self) -> Model:
        """The model, with its tail and its number of lobes."""
        return MODELS[self.model].of(self.tail, self.lobes)

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in texels."""
        height, width = self.channels["label"].shape
        return height, width

    def part(self, rows: slice, columns: slice) -> "Material":
        """Return the material of a part of the fabric."""
        return replace(self, channels={name: plane[rows, columns] for name, plane in self.channels.items()})

    def residual_maps(self, rows: slice = slice(None)) -> Map:
        """Return the maps of the residual (count + 1, h, W, 3): the mean over the lights, then the components."""
        assert self.residual is not None
        planes = [self.channels[name][rows] for name in residual_names(self.residual.count)]
        return np.stack([np.stack(planes[k : k + 3], -1) for k in range(0, len(planes), 3)])

    def terms(self, rows: slice = slice(None)) -> list[tuple[Map, Map]]:
        """Return colour · amplitude (h, W, 3) and shape (h, W, n) of the diffuse term, then of each lobe.

        Widths are at least `WIDTH_FLOOR`. A texel without a lobe has an arbitrary shape in the file; it gets the mean
        shape of the others, so that no division by zero occurs and filtering mixes in no arbitrary shapes.
        """
        terms = []
        for k, (name, shape) in enumerate(self.reflection.terms.items()):
            amplitude = self.channels[f"{name}.amplitude"][rows, :, None]
            colour = np.stack([self.channels[f"{name}.{c}"][rows] for c in "RGB"], -1) * amplitude
            values = np.stack([self.channels[f"{name}.{s}"][rows] for s in shape], -1)
            if k:
                values[amplitude[..., 0] <= 0] = self._fill[k - 1]
                self.reflection.floor_widths(values)
            terms.append((colour, values))
        return terms

    @cached_property
    def _fill(self) -> list[list[float]]:
        """Mean shape of each lobe, weighted by its amplitude."""
        means = []
        for name, shape in list(self.reflection.terms.items())[1:]:
            weight = np.asarray(self.channels[f"{name}.amplitude"], np.float64)
            total = weight.sum()
            values = {s: self.channels[f"{name}.{s}"] for s in shape}
            means.append([float((weight * v).sum() / total) if total > 0 else shape[s] for s, v in values.items()])
        return means


def channel_names(model: Model, residual: Residual | None = None) -> list[str]:
    """Return the names of the channels of a material with this model and residual."""
    names = [f"{t}.{c}" for t, shape in model.terms.items() for c in ("R", "G", "B", "amplitude", *shape)]
    return ["label", "bound", *names, *(residual_names(residual.count) if residual else ())]


def read_material(path: str | os.PathLike[str]) -> Material:
    """Read a material file, and check its checksum (`kinran_bsdf.checksum`) where it has one.

    Raises
    ------
    ValueError
        The file is missing or not an EXR, lacks a channel or an attribute, has another version or an unknown model,
        does not match its checksum, or holds values outside the model; the message is one sentence that names the file.
    """
    path = Path(path)
    if not path.is_file():
        raise ValueError(f"{path}: no such file; give a material that `fit` wrote")
    try:
        bitmap = mi.Bitmap(str(path), mi.Bitmap.FileFormat.OpenEXR)
        pixels = np.asarray(bitmap)
    except RuntimeError as error:
        raise ValueError(f"{path}: cannot be read as EXR ({error}); write the material again") from None
    metadata = bitmap.metadata()
    header = {key[len("kinran:") :]: str(metadata[key]) for key in metadata if key.startswith("kinran:")}
    names = [field.name for field in bitmap.struct_()]
    pixels = np.atleast_3d(pixels)
    channels = {name: np.asarray(pixels[..., k], np.float32) for k, name in enumerate(names)}  # views
    material = _from_header(path, header, channels)
    attributes = {f"kinran:{key}": value for key, value in header.items()}
    if checksum.NAME not in attributes:
        _say_unchecked(path)
    if what := checksum.damaged(attributes, channels):
        raise ValueError(
            f"{path}: {what} does not match the checksum in its header; write the material again, or remove the"
            f" attribute {checksum.NAME} if it was edited on purpose"
        )
    check(material, str(path))
    return material


@cache
def _say_unchecked(path: Path) -> None:
    """Say once that a file has no checksum."""
    log.warning("%s: has no checksum (%s), so that damage would not be seen; it is read as it is", path, checksum.NAME)


def _from_header(path: Path, header: dict[str, str], channels: dict[str, Map]) -> Material:
    for key in NEEDED:
        if key not in header:
            raise ValueError(f"{path}: has no attribute kinran:{key}; it is not a Kinran material")
        if key == "version" and header[key] != VERSION:
            raise ValueError(f"{path}: kinran:version is '{header[key]}' but this plugin reads '{VERSION}'; update one")
        if key == "cosine" and header[key] != "included":
            raise ValueError(f"{path}: kinran:cosine is '{header[key]}'; the plugin needs T = f_r cos θ ('included')")
    try:
        return Material(
            channels=channels,
            model=header["model"],
            tail=header.get("tail", TAILS[0]),
            lobes=int(header["lobes"]),
            regions=json.loads(header["regions"]),
            colour=header["colour"],
            from_stack=np.array(json.loads(header["from_stack"]), np.float64),
            texel_mm=float(header["texel_mm"]) if header["texel_mm"] else None,
            source=header["source"],
            theta_max=float(json.loads(header["measured"])["theta_max"]),
            encoding=header.get("encoding", ""),
            crop=header.get("crop", ""),
            residual=Residual.from_json(header["residual"]) if header.get("residual") else None,
        )
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{path}: a kinran: attribute cannot be read ({error}); write the material again") from None


def check(material: Material, name: str) -> None:
    """Refuse a material that its model cannot render.

    Raises
    ------
    ValueError
        The message is one sentence: file (`name`), value, remedy.
    """
    m = material
    if m.model not in MODELS:
        raise ValueError(f"{name}: model '{m.model}' is not one of {', '.join(MODELS)}; update the plugin")
    if m.tail not in TAILS:
        raise ValueError(f"{name}: tail '{m.tail}' is not one of {', '.join(TAILS)}; update the plugin")
    if m.lobes not in MODELS[m.model].counts:
        raise ValueError(f"{name}: {m.lobes} lobes do not go with model '{m.model}'; fit it again")
    if m.colour != COLOUR:
        raise ValueError(f"{name}: colour space '{m.colour}' is not '{COLOUR}'; convert the maps")
    if m.from_stack.shape != (3, 3) or not np.isfinite(m.from_stack).all() or not np.linalg.det(m.from_stack):
        raise ValueError(f"{name}: from_stack is not an invertible 3×3 matrix; calibrate the colour again")
    for channel in channel_names(m.reflection, m.residual):
        if channel not in m.channels:
            raise ValueError(f"{name}: has no channel '{channel}', which model '{m.model}' needs; fit it again")
        if not np.isfinite(m.channels[channel]).all():
            raise ValueError(f"{name}: channel '{channel}' holds values that are not finite; fit it again")
        if channel.endswith("amplitude") and m.channels[channel].min() < 0:
            raise ValueError(f"{name}: channel '{channel}' is negative ({m.channels[channel].min():g}); fit it again")
    bound = m.channels["bound"]
    if bound.min() <= 0 or bound.max() > 1:
        raise ValueError(f"{name}: channel 'bound' leaves (0, 1]: {bound.min():g} to {bound.max():g}; fit it again")
    for lobe, shape in list(m.reflection.terms.items())[1:]:
        used = m.channels[f"{lobe}.amplitude"] > 0
        bad = m.reflection.without_width([m.channels[f"{lobe}.{s}"][used] for s in shape])
        if bad.any():
            raise ValueError(f"{name}: {int(bad.sum())} texels of {lobe} have no positive width; fit it again")


def write_material(path: str | os.PathLike[str], material: Material) -> None:
    """Write a material file under a temporary name, read it back, and give it its name.

    Raises
    ------
    ValueError
        The material is not one that `read_material` accepts, or its maps differ in size.
    ImportError
        OpenEXR is missing; the plugin's extra ``write`` installs it.
    OSError
        The folder cannot be written to, or the file reads back changed.
    """
    try:
        import OpenEXR
    except ImportError:  # whoever renders needs none
        raise ImportError(f"{path}: to write it takes OpenEXR; install kinran-bsdf[write]") from None
    path = Path(path)
    check(material, str(path))
    names = channel_names(material.reflection, material.residual)
    names += sorted(set(material.channels) - set(names))
    shapes = {material.channels[n].shape for n in names}
    if len(shapes) != 1:
        raise ValueError(f"{path}: the maps have different sizes {sorted(shapes)}; give them one")
    stored = {name: _stored(name, material.channels[name]) for name in names}
    planes = {name: np.asarray(plane, np.float32) for name, plane in stored.items()}
    attributes = {f"kinran:{key}": value for key, value in _header(material).items()}
    attributes[checksum.NAME] = json.dumps(checksum.checksums(attributes, planes))
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.part.exr")
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        tiles = OpenEXR.TileDescription()
        tiles.xSize = tiles.ySize = TILE
        layout = {"type": OpenEXR.tiledimage, "tiles": tiles, "compression": OpenEXR.ZIP_COMPRESSION}
        with OpenEXR.File({**attributes, **layout}, stored) as file:
            file.write(str(temporary))
        back = read_material(temporary)
        if any(not np.array_equal(back.channels[name], plane) for name, plane in planes.items()):
            raise OSError(f"{path}: reads back changed; is the disk full?")
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def _stored(name: str, channel: Map) -> NDArray[np.floating]:
    """Return a channel as it is stored: a residual's in half precision, whose 3·10⁻⁴ no display shows."""
    return np.ascontiguousarray(channel, np.float16 if name.startswith("residual") else np.float32)


def _header(material: Material) -> dict[str, str]:
    return {
        "version": VERSION,
        "model": material.model,
        "tail": material.tail,
        "lobes": str(material.lobes),
        "regions": json.dumps(material.regions, ensure_ascii=False),
        "frame": FRAME,
        "cosine": "included",
        "units": "1/sr",
        "colour": material.colour,
        "from_stack": json.dumps(np.asarray(material.from_stack, float).tolist()),
        "texel_mm": "" if material.texel_mm is None else repr(float(material.texel_mm)),
        "source": material.source,
        "measured": json.dumps({"theta_max": float(material.theta_max)}),
        "encoding": material.encoding,
        "crop": material.crop,
        "residual": material.residual.to_json() if material.residual else "",
    }
