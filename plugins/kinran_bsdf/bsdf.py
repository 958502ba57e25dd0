"""The BSDF `kinran`, for the current variant of Mitsuba."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import drjit as dr
import numpy as np

from kinran_bsdf.arrays import mi
from kinran_bsdf.maps import PackedMaps, Term, Texel, TextureMaps
from kinran_bsdf.material import read_material
from kinran_bsdf.models import MODELS, TAILS, Slope
from kinran_bsdf.models.lambert import diffuse_albedo, diffuse_lift
from kinran_bsdf.models.model import GRAZING, grazing, release

DEFENSIVE = 0.1
"""Share of samples that terms get evenly, whatever their albedo: a choice."""
RESIDUAL_LEAST = 1e-6
"""Least albedo of the diffuse term in sampling where there is a residual, which can be bright where all terms are 0. A
choice: any positive number keeps sampling unbiased."""


_shared: list[dict[tuple[Any, ...], Any]] = []
"""Maps of the materials that were read, for each `shared_maps` that has not ended. Mitsuba's threads share it."""


@contextmanager
def shared_maps() -> Iterator[None]:
    """Read a material once, however many scenes with it are loaded in this context, as for the frames of an animation.

    Its files must stay as they are meanwhile. What is changed through `mi.traverse` changes in all of these scenes.
    """
    _shared.append(_shared[-1] if _shared else {})
    try:
        yield
    finally:
        _shared.pop()


def register() -> None:
    """Register the type `kinran` with the current variant."""
    mi.register_bsdf("kinran", _make_class())


def _make_class() -> Any:
    """Define the class for the current variant: its base is another type in each."""

    class Kinran(mi.BSDF):
        """Measured fabric; docs/plugin.md lists the parameters."""

        def __init__(self, props: Any) -> None:
            mi.BSDF.__init__(self, props)
            pixel_angle = float(props.get("pixel_angle", 0.0))
            self.maps, floor = _maps(props, pixel_angle > 0)
            self.model, self.lobes = self.maps.model, self.maps.model.lobes
            transform = props.get("to_uv", mi.ScalarTransform4f())
            self.to_uv = np.array(transform.matrix, np.float64)[:2, [0, 1, 3]]
            # opaque: literals would give each fabric a kernel of its own
            self.floor = dr.opaque(mi.Float, floor)
            self.rows = [[dr.opaque(mi.Float, float(v)) for v in row] for row in self.to_uv]
            self.weft = [dr.opaque(mi.Float, float(v)) for v in np.linalg.pinv(self.to_uv[:, :2])[:, 0]]
            self.pixel_angle = pixel_angle
            self._measure()
            self.back: Any = props.get_texture("back") if "back" in props else None
            self._set_flags()

        def _measure(self) -> None:
            """Set `per_texel`: texels of the unit square of texture coordinates, times the solid angle of a pixel."""
            self.per_texel = None
            if self.pixel_angle:
                height, width = self.maps.size
                texels = height * width * abs(float(np.linalg.det(self.to_uv[:, :2])))
                self.per_texel = dr.opaque(mi.Float, texels * self.pixel_angle**2)

        def _set_flags(self) -> None:
            varying = mi.BSDFFlags.SpatiallyVarying
            front, back = mi.BSDFFlags.FrontSide, mi.BSDFFlags.BackSide
            lobe = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.Anisotropic | front | varying
            diffuse = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.Anisotropic | front | varying
            components = [lobe] * self.lobes + [diffuse]
            if self.back is not None:
                components.append(mi.BSDFFlags.DiffuseReflection | back | varying)
            self.m_components = components
            self.m_flags = components[0]
            for flags in components[1:]:
                self.m_flags = self.m_flags | flags

        # ---------------------------------------------------------------------------------- at a point

        def _uv(self, si: Any) -> Any:
            if np.array_equal(self.to_uv, np.eye(2, 3)):
                return si.uv
            return mi.Point2f(*[a * si.uv.x + b * si.uv.y + c for a, b, c in self.rows])

        def _texel(self, si: Any, active: Any) -> Texel:
            return self.maps.fetch(si, self._uv(si), None if self.per_texel is None else self._level(si), active)

        def _level(self, si: Any) -> Any:
            """Return the level of the pyramid whose texels are as large as a pixel's footprint.

            Integrators hand no ray differentials to BSDFs. The distance from the previous vertex times the angle of a
            pixel is the footprint of a camera ray, and smaller than that of a bounce.
            """
            texels = self.per_texel * dr.square(si.t) / dr.maximum(si.wi.z, 0.1)
            return 0.5 * dr.log2(dr.maximum(texels, 1e-20) / dr.maximum(dr.norm(dr.cross(si.dp_du, si.dp_dv)), 1e-20))

        def _axes(self, si: Any) -> tuple[Any, Any, Any]:
            """Return the weft's cosine and sine in the shading frame (None: 1, 0), and the sign for a warp along +v."""
            m = self.to_uv[:, :2]
            sign = dr.select(dr.dot(si.sh_frame.t, si.dp_dv) < 0, mi.Float(-1), mi.Float(1))
            if m[0, 1] == 0 and m[1, 0] == 0 and m[0, 0] > 0:
                return None, None, sign * float(np.sign(m[1, 1]))
            along = si.dp_du * self.weft[0] + si.dp_dv * self.weft[1]
            x, y = dr.dot(si.sh_frame.s, along), dr.dot(si.sh_frame.t, along)
            length = dr.maximum(dr.sqrt(x * x + y * y), 1e-20)
            return x / length, y / length, sign * float(np.sign(np.linalg.det(m)))

        @staticmethod
        def _to_fabric(axes: Any, w: Any) -> Any:
            """Turn a direction from the shading frame to the frame of the fabric: X weft, Y warp."""
            c, s, sign = axes
            if c is None:
                return mi.Vector3f(w.x, sign * w.y, w.z)
            return mi.Vector3f(c * w.x + s * w.y, sign * (c * w.y - s * w.x), w.z)

        @staticmethod
        def _from_fabric(axes: Any, w: Any) -> Any:
            c, s, sign = axes
            y = sign * w.y
            if c is None:
                return mi.Vector3f(w.x, y, w.z)
            return mi.Vector3f(c * w.x - s * y, s * w.x + c * y, w.z)

        def _enabled(self, ctx: Any) -> tuple[list[bool], bool]:
            """Return whether each term (diffuse, then lobes) is enabled, and whether the back side is."""
            glossy, diffuse = mi.BSDFFlags.GlossyReflection, mi.BSDFFlags.DiffuseReflection
            lobes = [ctx.is_enabled(glossy, k) for k in range(self.lobes)]
            back = self.back is not None and ctx.is_enabled(diffuse, self.lobes + 1)
            return [ctx.is_enabled(diffuse, self.lobes), *lobes], back

        def _probabilities(self, terms: list[Term], enabled: list[bool]) -> list[Any]:
            """Return the probability of sampling each term: its share of the albedo at V = N, and a defensive share."""
            weights = []
            for k, term in enumerate(terms):
                if not enabled[k]:
                    weights.append(mi.Float(0))
                    continue
                unit = self.model.albedo(term.shape, xp=dr) if k else dr.pi
                least = RESIDUAL_LEAST if k == 0 and self.maps.residual is not None else 0.0
                weights.append(dr.detach(dr.maximum(dr.maximum(term.strength, 0) * unit, least)))
            total = sum(weights)
            share = DEFENSIVE / sum(enabled) * total if any(enabled) else 0
            weights = [dr.select(w > 0, w + share, 0) for w in weights]
            norm = 1 / dr.maximum(sum(weights), 1e-20)
            return [w * norm for w in weights]

        def _value(self, si: Any, texel: Texel, enabled: list[bool], v: Any, l: Any) -> Any:  # noqa: E741
            """Return T as a spectrum; the residual belongs to the diffuse term."""
            terms = texel.terms
            if self.maps.residual is not None and enabled[0]:
                change = self._residual(texel, v, l)
                factors = [f if on else 0 for f, on in zip(self._factors(terms, v, l), enabled, strict=True)]
                whole = [dr.maximum(a + b, 0) for a, b in zip(_bands(terms, factors), change, strict=True)]
                return self.maps.spectrum(si, whole, True)
            value = mi.UnpolarizedSpectrum(0)
            for term, factor, on in zip(terms, self._factors(terms, v, l), enabled, strict=True):
                if on:
                    value += term.colour * factor
            return value

        def _factors(self, terms: list[Term], v: Any, l: Any) -> list[Any]:  # noqa: E741
            """Return the factor of each term's colour · amplitude for a view and a light."""
            x, y = terms[0].shape
            factors = [diffuse_lift(v, l, x, y, self.floor, xp=dr)]
            for term in terms[1:]:
                factors.append(self.model.lobe(v, l, term.shape, self.floor, xp=dr))
            return factors

        def _residual(self, texel: Texel, v: Any, l: Any) -> list[Any]:  # noqa: E741
            """Return the residual's change of T, three bands in Rec. 709.

            It is that under the light with the same half vector at the measured view, and fades out at other views.
            """
            h = dr.normalize(v + l)
            view = mi.Vector3f(0, 0, 1)
            light = mi.Vector3f(2 * h.z * h.x, 2 * h.z * h.y, 2 * h.z * h.z - 1)
            lobes = _bands(texel.terms, self._factors(texel.terms, view, light))
            measured = light.z >= self.floor
            change = self.maps.residual.change(lobes, texel.residual, light, measured)
            fade = dr.select(measured, release(v, l, xp=dr), 0)
            return [fade * c for c in change]

        def _density(self, terms: list[Term], p: list[Any], v: Any, l: Any) -> Any:  # noqa: E741
            density = p[0] * l.z * dr.inv_pi
            for probability, term in zip(p[1:], terms[1:], strict=True):
                density += probability * self.model.density(term.shape, v, l)
            return density

        # ---------------------------------------------------------------------------------- interface

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            bs = dr.zeros(mi.BSDFSample3f)
            enabled, back = self._enabled(ctx)
            front = active & (si.wi.z > 0)
            if _none(front) and not (back and not _none(active & (si.wi.z < 0))):
                return bs, mi.Spectrum(0)
            texel = self._texel(si, front)
            terms = texel.terms
            p = self._probabilities(terms, enabled)
            axes = self._axes(si)
            v = self._to_fabric(axes, si.wi)
            light = mi.warp.square_to_cosine_hemisphere(sample2)
            component = mi.UInt32(self.lobes)
            if self.lobes:
                first = sample1 < p[1]
                shape = terms[1].shape
                if self.lobes == 2:
                    shape = [dr.select(first, a, b) for a, b in zip(shape, terms[2].shape, strict=True)]
                pick = sample1 < sum(p[1:])
                h = self.model.sample(shape, sample2)
                light = dr.select(pick, mi.reflect(v, mi.Normal3f(h)), light)
                component = dr.select(pick, dr.select(first, mi.UInt32(0), mi.UInt32(self.lobes - 1)), component)
            light = dr.detach(light)
            good = front & (light.z > 0)
            density = dr.detach(self._density(terms, p, v, light))
            good &= density > 0
            value = dr.select(good, self._value(si, texel, enabled, v, light) / dr.maximum(density, 1e-20), 0)
            bs.wo = self._from_fabric(axes, light)
            bs.pdf = dr.select(good, density, 0)
            if back:
                behind = active & (si.wi.z < 0)
                wo = mi.warp.square_to_cosine_hemisphere(sample2)
                bs.wo = dr.select(behind, mi.Vector3f(wo.x, wo.y, -wo.z), bs.wo)
                bs.pdf = dr.select(behind, wo.z * dr.inv_pi, bs.pdf)
                value = dr.select(behind, mi.unpolarized_spectrum(self.back.eval(si, behind)), value)
                component = dr.select(behind, mi.UInt32(self.lobes + 1), component)
            bs.eta = 1.0
            bs.sampled_component = component
            bs.sampled_type = dr.select(
                component < self.lobes,
                mi.UInt32(+mi.BSDFFlags.GlossyReflection),
                mi.UInt32(+mi.BSDFFlags.DiffuseReflection),
            )
            return bs, mi.depolarizer(value)

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self._eval_pdf(ctx, si, wo, active, pdf=False)[0]

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self._eval_pdf(ctx, si, wo, active, value=False)[1]

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self._eval_pdf(ctx, si, wo, active)

        def _eval_pdf(
            self, ctx: Any, si: Any, wo: Any, active: Any, value: bool = True, pdf: bool = True
        ) -> tuple[Any, Any]:
            wo = mi.Vector3f(wo)
            enabled, back = self._enabled(ctx)
            result, density = mi.UnpolarizedSpectrum(0), mi.Float(0)
            seen = active & (si.wi.z > 0)
            front = seen & (wo.z > 0)
            if not _none(front) and any(enabled):
                texel = self._texel(si, seen)  # the mask that `sample` has: integrators trace both, one look-up
                axes = self._axes(si)
                v, l = self._to_fabric(axes, si.wi), self._to_fabric(axes, wo)  # noqa: E741
                if value:
                    result = dr.select(front, self._value(si, texel, enabled, v, l), 0)
                if pdf:
                    p = self._probabilities(texel.terms, enabled)
                    density = dr.select(front, self._density(texel.terms, p, v, l), 0)
            if back:
                behind = active & (si.wi.z < 0) & (wo.z < 0)
                cosine = dr.select(behind, -wo.z * dr.inv_pi, 0)
                if value:
                    result += mi.unpolarized_spectrum(self.back.eval(si, behind)) * cosine
                density += cosine
            return mi.depolarizer(result), dr.detach(density)

        def eval_diffuse_reflectance(self, si: Any, active: Any = True) -> Any:
            term = self._texel(si, active).terms[0]
            return mi.depolarizer(term.colour * diffuse_albedo(*term.shape, xp=dr))

        def has_attribute(self, name: str, active: Any = True) -> Any:
            return active & (name == "measured_distance" or name in self.maps.attributes)

        def eval_attribute_1(self, name: str, si: Any, active: Any = True) -> Any:
            if name == "measured_distance":
                return dr.select(active, dr.safe_acos(dr.abs(si.wi.z)), 0)
            if name in self.maps.attributes:
                return self.maps.attribute(name, self._uv(si), active)
            return super().eval_attribute_1(name, si, active)

        def traverse(self, callback: Any) -> None:
            self.maps.traverse(callback)
            if self.back is not None:
                callback.put("back", self.back, mi.ParamFlags.Differentiable)

        def parameters_changed(self, keys: Sequence[str] = ()) -> None:
            if not keys or "maps" in keys:
                self.maps.changed()
                self._measure()

        def to_string(self) -> str:
            values = {"model": self.model.name} | vars(self.model)
            return f"Kinran[{', '.join(f'{name}={value}' for name, value in values.items())}]"

    return Kinran


def _bands(terms: list[Term], factors: list[Any]) -> list[Any]:
    """Return T, three bands in Rec. 709, of terms with their factors."""
    return [sum(f * t.bands[c] for f, t in zip(factors, terms, strict=True)) for c in range(3)]


def _none(mask: Any) -> bool:
    """Return whether a mask is a scalar variant's False; JIT variants never know."""
    return isinstance(mask, bool) and not mask


def _maps(props: Any, pyramid: bool) -> tuple[Any, float]:
    """Return the maps of a BSDF, and the cosine from which it fades to the horizon."""
    if "filename" not in props:
        if pyramid:
            raise ValueError("kinran: pixel_angle needs a material file; textures have no pyramid")
        model = MODELS[_choice(props, "model", Slope.name, tuple(MODELS))]
        tail = _choice(props, "tail", TAILS[0], TAILS)
        lobes = max((n for n in model.counts if f"lobe{n}" in props), default=model.counts[0])
        return TextureMaps(props, model.of(tail, lobes)), GRAZING
    path = str(mi.file_resolver().resolve(props["filename"]))
    choices = str(props.get("filter", "")), str(props.get("wrap_mode", ""))
    key = (mi.variant(), path, *choices, pyramid)
    known = _shared[-1] if _shared else {}
    if key not in known:
        known[key] = _packed(props, path, pyramid)
    return known[key]


def _packed(props: Any, path: str, pyramid: bool) -> tuple[PackedMaps, float]:
    """Return the maps of a material file, and the cosine from which it fades to the horizon."""
    material = read_material(path)
    filtered, what = material.reflection.filtered, f"would average angles of {material.model}"
    mode = _choice(props, "filter", "bilinear" if filtered else "nearest", ("nearest", "bilinear"))
    if not filtered and mode != "nearest":
        raise ValueError(f"kinran: filter 'bilinear' {what}; use 'nearest' or fit {Slope.name}")
    if not filtered and pyramid:
        raise ValueError(f"kinran: pixel_angle {what}; leave it out or fit {Slope.name}")
    wrap = _choice(props, "wrap_mode", "repeat", ("repeat", "clamp"))
    floor = grazing(material.theta_max)
    return PackedMaps(material, mode, wrap, floor, pyramid), floor


def _choice(props: Any, name: str, default: str, choices: tuple[str, ...]) -> str:
    value = str(props.get(name, default))
    if value not in choices:
        raise ValueError(f"kinran: {name} '{value}' is not one of {', '.join(choices)}")
    return value
