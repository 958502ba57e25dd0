"""Map the standard deviation of each channel of a fitted material, and the widths that the lights do not resolve."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from kinran.base import pictures
from kinran.base.exr import write_exr
from kinran.base.files import InputError, write_json
from kinran.base.log import progress
from kinran.data.fabric import Fabric
from kinran.fit import gauss_newton, slope
from kinran.fit.region_priors import Priors
from kinran.fit.samples import Samples, read_samples
from kinran.fit.slope import SlopeFit
from kinran.fit.slope_lobes import Lobes
from kinran.fit.solver.lobes import LOBE_SIZE, narrowest
from kinran_bsdf.material import Material, read_material
from kinran_bsdf.models import Slope

Array = NDArray[np.float64]
Map = NDArray[np.float32]

UNSURE = 0.3
"""Standard deviation of the logarithm of a lobe's area from which its width counts as not resolved. A choice."""
AT_BOUND = 1.02
"""Width of a lobe, over the least width that the lights resolve, up to which it counts as at that bound: rounding alone
makes no more of it. A choice."""
MAP_WIDTH = 200
"""Pixels across each map of the picture."""


@dataclass(frozen=True)
class Inputs:
    """Files that the stage reads."""

    fabric: Annotated[Path, "folder of the fabric: radiance.zarr, labels.exr, regions.json"]
    prior: Annotated[Path, "priors of the regions (.json)"]
    material: Annotated[Path, "slope material, without a residual (.exr)"]


@dataclass(frozen=True)
class Outputs:
    """Files that the stage writes."""

    maps: Annotated[Path, "OUT", "maps sigma.CHANNEL and LOBE.unresolved (.exr)"]
    summary: Annotated[Path, "medians of each region (.json)"]
    picture: Annotated[Path, "the maps, for people (.png)"]


@dataclass(frozen=True)
class Options:
    """Options of the run."""

    threads: Annotated[int, "threads of this machine"] = 1


def main(inputs: Inputs, out: Outputs, options: Options = Options()) -> None:
    """Write the maps, their medians by region and a picture."""
    fabric = Fabric(inputs.fabric)
    stack, labels = fabric.stack, fabric.labels
    material = read_material(inputs.material)
    if not isinstance(material.reflection, Slope):
        raise InputError(f"{inputs.material}: is of model {material.model}; give one of model {Slope.name}")
    priors = Priors.read(inputs.prior, fabric)
    least = AT_BOUND * slope.resolution(stack.directions[~stack.held_out], material.lobes)
    maps: dict[str, Map] = {}
    for box in progress(stack.tiles(), "sigma", "tiles"):
        y0, y1, x0, x1 = box
        part = material.part(slice(y0, y1), slice(x0, x1))
        tile = read_samples(fabric, box).weighed(priors.lights)
        for name, values in _tile(part, tile, priors, least, options.threads).items():
            plane = maps.setdefault(name, np.zeros(labels.shape, np.float32))
            plane[y0:y1, x0:x1] = values.reshape(y1 - y0, x1 - x0)
    write_exr(out.maps, maps)
    regions = {region.name: (labels == region.label) & stack.inside for region in fabric.regions}
    write_json(out.summary, {name: summary(material, maps, inside) for name, inside in regions.items()})
    pictures.write_png(out.picture, picture(material, maps))


def _tile(part: Material, tile: Samples, priors: Priors, least: float, threads: int) -> dict[str, Array]:
    """Maps (texel,) of one tile; `least` is the width that the lights resolve."""
    fitted = parameters(part)
    stiffness = np.stack([prior.stiffness() for prior in priors.regions])[tile.region]
    stiffness[fitted.colours[:, :-1].max((1, 2)) <= 0] = 0  # a texture that was fitted without its prior
    covariance = gauss_newton.covariances(fitted, tile, stiffness, threads)
    return {**deviations(part, fitted.shapes, covariance), **unresolved(fitted, covariance, least)}


def parameters(material: Material) -> SlopeFit:
    """The fit, in the stack's unit, that a slope material was made from; its cost is not known, and NaN."""
    back = np.pi * np.linalg.inv(material.from_stack)
    (diffuse, normals), *lobes = material.terms()
    shapes = []
    for _, shape in lobes:
        x, y, xx, xy, yy = shape.reshape(-1, 5).T.astype(float)
        # S⁻¹ = Uᵀ U with U = [[e^α, β], [0, e^γ]]
        determinant = np.maximum(xx * yy - xy * xy, 1e-12 * xx * yy)
        alpha = 0.5 * np.log(yy / determinant)
        shapes += [x, y, alpha, -xy / determinant * np.exp(-alpha), -0.5 * np.log(yy)]
    shapes += list(normals.reshape(-1, 2).T.astype(float))
    colours = [colour.reshape(-1, 3) @ back.T for colour, _ in [*lobes, (diffuse, normals)]]
    P = np.stack(shapes, 1)
    unknown = np.full(len(P), np.nan)
    return SlopeFit(Lobes(material.tail, material.lobes), P, np.stack(colours, 1), unknown, np.zeros(len(P), bool))


def deviations(material: Material, shapes: Array, covariance: Array) -> dict[str, Array]:
    """Deviations ``sigma.CHANNEL`` (texel,) of each shape and colour; colours times their amplitudes, in 1/sr."""
    maps = {}
    for k in range(material.lobes):
        at = slice(LOBE_SIZE * k, LOBE_SIZE * (k + 1))
        sd = propagated(covariance[:, at, at], _of_widths(shapes[:, at]))
        maps.update({f"sigma.lobe{k + 1}.{name}": sd[:, i] for i, name in enumerate(Slope.parameters)})
    size = shapes.shape[1]
    normal = slice(size - 2, size)
    sd = propagated(covariance[:, normal, normal], np.eye(2)[None])
    maps.update({f"sigma.diffuse.{name}": sd[:, i] for i, name in enumerate("xy")})
    for k, part in enumerate([*(f"lobe{k + 1}" for k in range(material.lobes)), "diffuse"]):
        at = slice(size + 3 * k, size + 3 * k + 3)
        sd = propagated(covariance[:, at, at], material.from_stack[None] / np.pi)
        maps.update({f"sigma.{part}.{c}": sd[:, i] for i, c in enumerate("RGB")})
    return maps


def propagated(covariance: Array, jacobian: Array) -> Array:
    """Standard deviations (texel, m) of values, from the covariance (texel, n, n) of parameters and its Jacobian.

    Parameters
    ----------
    covariance : (texel, n, n)
        Infinite on the diagonal where nothing fixes a parameter; values that depend on it are infinite, too.
    jacobian : (texel or 1, m, n)
        Derivatives of the values by the parameters.
    """
    known = np.isfinite(np.diagonal(covariance, axis1=1, axis2=2))
    finite = np.where(known[:, :, None] & known[:, None], covariance, 0)
    J = np.broadcast_to(jacobian, (len(covariance), *jacobian.shape[1:]))
    variance = np.einsum("tmi,tij,tmj->tm", J, finite, J)
    free = ((J != 0) & ~known[:, None]).any(2)
    return np.where(free, np.inf, np.sqrt(np.maximum(variance, 0)))


def _of_widths(lobe: Array) -> Array:
    """Derivatives (texel, 5, 5) of (x, y, S_xx, S_xy, S_yy) by (μ_x, μ_y, α, β, γ)."""
    i00, i11 = np.exp(-lobe[:, 2]), np.exp(-lobe[:, 4])
    i01 = -lobe[:, 3] * i00 * i11
    J = np.zeros((len(lobe), 5, 5))
    J[:, 0, 0] = J[:, 1, 1] = 1
    J[:, 2, 2], J[:, 2, 3], J[:, 2, 4] = -2 * (i00**2 + i01**2), -2 * i01 * i00 * i11, -2 * i01**2
    J[:, 3, 2], J[:, 3, 3], J[:, 3, 4] = -i01 * i11, -i00 * i11**2, -2 * i01 * i11
    J[:, 4, 4] = -2 * i11**2
    return J


def unresolved(fitted: SlopeFit, covariance: Array, least: float) -> dict[str, Array]:
    """Maps ``LOBE.unresolved`` (texel,): 1 where the lights cannot tell how wide a lobe is.

    Such a lobe is no wider than `least`, the least width that the lights resolve, along one of its axes; or the
    logarithm of its area has a standard deviation over 0.3.
    """
    maps = {}
    for k in range(fitted.lobes.count):
        at = LOBE_SIZE * k
        alpha, gamma = at + 2, at + 4
        V = covariance[:, [[alpha], [gamma]], [[alpha, gamma]]]
        unsure = ~(V.sum((1, 2)) < UNSURE**2)
        narrow = narrowest(fitted.lobe(k)) <= least
        there = fitted.colours[:, k].max(1) > 0
        maps[f"lobe{k + 1}.unresolved"] = (there & (narrow | unsure)).astype(float)
    return maps


def summary(material: Material, maps: dict[str, Map], inside: NDArray[np.bool_]) -> dict[str, dict[str, float | None]]:
    """Medians over the texels of a region that have the lobe: directions in degrees, amplitudes relative."""
    result = {}
    for k in range(1, material.lobes + 1):
        lobe = f"lobe{k}"
        there = inside & (material.channels[f"{lobe}.amplitude"] > 0)
        if not there.any():
            continue
        result[lobe] = {
            "share_of_texels": round(float(there.sum() / inside.sum()), 4),
            "normal_degrees": _median(normal_degrees(maps, lobe)[there]),
            "amplitude_relative": _median(relative(material, maps, lobe)[there]),
            "unresolved": round(float(maps[f"{lobe}.unresolved"][there].mean()), 4),
        }
    return result


def normal_degrees(maps: dict[str, Map], lobe: str) -> Array:
    """Standard deviation (y, x) of a lobe's direction, in degrees."""
    x, y = (maps[f"sigma.{lobe}.{axis}"].astype(float) for axis in "xy")
    return np.asarray(np.degrees(np.arctan(np.hypot(x, y))))


def relative(material: Material, maps: dict[str, Map], lobe: str) -> Array:
    """Largest standard deviation (y, x) of a lobe's three colours, over its amplitude."""
    sd = np.max([maps[f"sigma.{lobe}.{c}"] for c in "RGB"], axis=0)
    return np.asarray(sd / np.maximum(material.channels[f"{lobe}.amplitude"], 1e-12), float)


def _median(values: Array) -> float | None:
    middle = float(np.median(values))
    return float(f"{middle:.4g}") if math.isfinite(middle) else None


def picture(material: Material, maps: dict[str, Map]) -> pictures.Picture:
    """Picture of the maps, one row for each lobe."""
    rows = []
    for k in range(1, material.lobes + 1):
        lobe = f"lobe{k}"
        there = material.channels[f"{lobe}.amplitude"] > 0
        shown = {
            f"{lobe}: normal, to 2 degrees": pictures.heat(_finite(normal_degrees(maps, lobe), there), 2),
            "amplitude, relative, to 0.5": pictures.heat(_finite(relative(material, maps, lobe), there), 0.5),
            "width not resolved": pictures.heat(maps[f"{lobe}.unresolved"], 1),
        }
        rows.append([(caption, pictures.enlarge(p, MAP_WIDTH)) for caption, p in shown.items()])
    return pictures.sheet(rows)


def _finite(values: Array, there: NDArray[np.bool_]) -> Array:
    """Values (y, x) to be shown: 0 where there is no lobe, 1e9 where the deviation has no bound."""
    return np.where(there, np.minimum(np.nan_to_num(values, posinf=1e9), 1e9), 0)
