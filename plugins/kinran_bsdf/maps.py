"""The parameters of texels: packed maps of a material file, or Mitsuba textures."""

from typing import Any, NamedTuple

import drjit as dr
import numpy as np

from kinran_bsdf import colours
from kinran_bsdf.arrays import Array, Map, mi, texture
from kinran_bsdf.material import Material
from kinran_bsdf.models import Model
from kinran_bsdf.models.lambert import diffuse_lift
from kinran_bsdf.pyramid import Pyramid, halve
from kinran_bsdf.residual_table import ResidualTable


class Term(NamedTuple):
    """One term of the model at a point: colour · amplitude as a spectrum, its mean over bands, its shape, its bands."""

    colour: Any
    strength: Any
    shape: list[Any]
    bands: list[Any]


class Texel(NamedTuple):
    """Parameters at a point: the diffuse term, then the lobes; and the residual's maps and `bound`, if there are."""

    terms: list[Term]
    residual: list[Any]


class PackedMaps:
    """All parameters of a material in one texture, so that a look-up is a single fetch.

    The channels are, for the diffuse term and then for each lobe, colour · amplitude · bound in the bands of the
    variant, then the shape. There are 3 bands, or 1 in mono without a residual, which is nonlinear in 3 bands. Lobes
    that are filtered have their albedo in place of their amplitude, so that filtering between a bright narrow lobe and
    a faint wide one keeps the energy. The maps of a residual and `bound` come last.
    """

    attributes = ("bound", "label")

    def __init__(self, material: Material, filter_mode: str, wrap_mode: str, floor: float, pyramid: bool) -> None:
        self.size, self.wrap_mode, self.floor = material.size, wrap_mode, floor
        self.model = material.reflection
        self.bands = 1 if mi.is_monochromatic and material.residual is None else 3
        packed = pack(material, self.bands)
        self.primaries = colours.Primaries()
        self.texture = texture(packed, filter_mode, wrap_mode)
        self.tensor: Any = None  # a copy of what the texture holds, made when somebody traverses
        self.residual = ResidualTable(material, material.residual) if material.residual else None
        self.pyramid = Pyramid(packed, self.next_level, wrap_mode) if pyramid else None
        extra = np.stack([material.channels[name] for name in self.attributes], -1)
        self.extra = texture(extra, "nearest", wrap_mode)

    def fetch(self, si: Any, uv: Any, level: Any, active: Any) -> Texel:
        """Return the texel at `uv`, from the pyramid where `level` is 0.5 or more."""
        if self.pyramid is None:
            values = list(self.texture.eval(uv, active))
        else:
            coarse = level >= 0.5
            fine = self.texture.eval(uv, active & (level < 0.5))
            far = self.pyramid.fetch(uv, level, active & coarse)
            values = [dr.select(coarse, a, b) for a, b in zip(far, fine, strict=True)]
        primaries = self.primaries.at(si.wavelengths, active)
        terms, rest = self._split(values, dr)
        found = []
        for colour, shape in terms:
            spectrum = colours.Primaries.spectrum(colour, primaries)
            found.append(Term(spectrum, sum(colour) / self.bands, shape, colour))
        return Texel(found, rest)

    def _split(self, values: list[Any], xp: Any) -> tuple[list[tuple[list[Any], list[Any]]], list[Any]]:
        """Split packed channels into colour · amplitude and shape of each term, and the channels after them."""
        terms, start = [], 0
        for k, parameters in enumerate(self.model.terms.values()):
            middle = start + self.bands
            end = middle + len(parameters)
            colour, shape = values[start:middle], values[middle:end]
            if k and self.model.filtered:
                inverse = 1 / xp.maximum(self.model.albedo(shape, xp=xp), 1e-12)
                colour = [c * inverse for c in colour]
            terms.append((colour, shape))
            start = end
        return terms, values[start:]

    def next_level(self, packed: Map, weights: Map | None) -> tuple[Map, Map]:
        """Return the next level of a pyramid, and the weights of its lobes."""
        coarse, weights = halve(packed, weights, self.bands, self.model)
        if self.residual is not None:
            coarse[..., -3 * self.residual.count - 4 : -1] = self.residual.averaged(packed, coarse, self.radiance)
        return coarse, weights

    def radiance(self, channels: list[Map], light: Array) -> list[Map]:
        """Return T of all terms without the residual (3 maps) under a light at the measured view."""
        ((diffuse, (x, y)), *lobes), _ = self._split(channels, np)
        view, l = (0.0, 0.0, 1.0), tuple(float(v) for v in light)  # noqa: E741 (the field's letter)
        lift = diffuse_lift(view, l, x, y, self.floor)
        total = [lift * c for c in diffuse]
        for colour, shape in lobes:
            value = self.model.lobe(view, l, shape, self.floor)
            total = [t + value * c for t, c in zip(total, colour, strict=True)]
        return total

    def spectrum(self, si: Any, values: list[Any], active: Any) -> Any:
        """Return the spectrum of three values in Rec. 709."""
        return colours.Primaries.spectrum(values, self.primaries.at(si.wavelengths, active))

    def attribute(self, name: str, uv: Any, active: Any) -> Any:
        """Return one of `attributes` at `uv`."""
        return self.extra.eval(uv, active)[self.attributes.index(name)]

    def traverse(self, callback: Any) -> None:
        """Expose the maps as the parameter `maps`."""
        if self.tensor is None:
            self.tensor = mi.TensorXf(self.texture.tensor())
        callback.put("maps", self.tensor, mi.ParamFlags.Differentiable)

    def changed(self) -> None:
        """Use maps that were changed through `mi.traverse`; a pyramid carries no gradients."""
        if self.tensor is None:
            return
        height, width, channels = self.tensor.shape
        if channels != self.texture.shape[2]:
            raise ValueError(f"kinran: maps have {self.texture.shape[2]} channels, not {channels}")
        self.size = height, width
        self.texture.set_tensor(self.tensor)
        if self.pyramid is not None:
            self.pyramid = Pyramid(np.array(dr.detach(self.tensor)), self.next_level, self.wrap_mode)


def pack(material: Material, bands: int) -> Map:
    """Return the channels of `PackedMaps` (H, W, n), made from some rows at a time to save memory."""
    height, width = material.size
    model = material.reflection
    count = sum(bands + len(parameters) for parameters in model.terms.values())
    if material.residual is not None:
        count += 3 * (material.residual.count + 1) + 1
    packed = np.empty((height, width, count), np.float32)
    step = max(1, (1 << 20) // width)
    for top in range(0, height, step):
        rows = slice(top, top + step)
        bound = material.channels["bound"][rows, :, None]
        terms = material.terms(rows)
        parts = []
        for k, (colour, shape) in enumerate(terms):
            colour = colours.pack(colour * bound, bands)
            if k and model.filtered:
                colour = colour * model.albedo(np.moveaxis(shape, -1, 0))[..., None]
            parts += [colour, shape]
        if material.residual is not None:
            parts += [*material.residual_maps(rows), bound]
        np.concatenate(parts, -1, out=packed[rows])
    return packed


class TextureMaps:
    """Parameters as constants or Mitsuba textures, named like the file's channels with `_` for the dot."""

    attributes = ()
    residual = None

    def __init__(self, props: Any, model: Model) -> None:
        self.model = model
        self.textures: dict[str, Any] = {}
        for name, parameters in model.terms.items():
            self.textures[name] = props.get_texture(name, 0.5)
            amplitude = 1 / np.pi if name == "diffuse" else 1.0
            self.textures[f"{name}_amplitude"] = props.get_unbounded_texture(f"{name}_amplitude", amplitude)
            for s, neutral in parameters.items():
                self.textures[f"{name}_{s}"] = props.get_unbounded_texture(f"{name}_{s}", neutral)

    def fetch(self, si: Any, uv: Any, level: Any, active: Any) -> Texel:
        """Return the texel at `si`; the textures transform `si.uv` themselves, and have no levels."""
        terms = []
        for k, (name, parameters) in enumerate(self.model.terms.items()):
            amplitude = dr.maximum(self.textures[f"{name}_amplitude"].eval_1(si, active), 0)
            colour = mi.unpolarized_spectrum(self.textures[name].eval(si, active)) * amplitude
            shape = [self.textures[f"{name}_{s}"].eval_1(si, active) for s in parameters]
            terms.append(Term(colour, dr.mean(colour), self.model.confined(shape) if k else shape, []))
        return Texel(terms, [])

    def traverse(self, callback: Any) -> None:
        """Expose each texture under its name."""
        for name, values in self.textures.items():
            callback.put(name, values, mi.ParamFlags.Differentiable)

    def changed(self) -> None:
        """Do nothing: no data are kept beside the textures."""
