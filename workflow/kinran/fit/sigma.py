"""Maps of how well the lights fix a fitted material: a standard deviation a channel, and what is not resolved."""

import argparse
import math
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinran import near, pictures
from kinran.exr import write_exr
from kinran.files import InputError, write_json
from kinran.fit import samples, slope, trust, uncertainty
from kinran.fit.lobes import LOBE_SIZE, narrowest
from kinran.labels import read_labels, read_regions
from kinran.stack import Stack
from kinran_bsdf.material import SHAPES, Material, read_material

Array = NDArray[np.float64]
Map = NDArray[np.float32]

UNSURE = 0.3
"""Standard deviation of the logarithm of a lobe's area from which its width counts as not resolved."""
AT_BOUND = 1.02
MAP_WIDTH = 200


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the stage."""
    parser.add_argument("--stack", type=Path, required=True, help="radiance stack (.zarr)")
    parser.add_argument("--labels", type=Path, required=True, help="label map (.exr)")
    parser.add_argument("--regions", type=Path, required=True, help="regions (.json)")
    parser.add_argument("--prior", type=Path, required=True, help="priors of the regions (.json)")
    parser.add_argument("--material", type=Path, required=True, help="slope material, without a residual (.exr)")
    parser.add_argument("--summary", type=Path, required=True, help="medians of each region (.json)")
    parser.add_argument("--picture", type=Path, required=True, help="the maps, for people (.png)")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("out", type=Path, help="maps sigma.CHANNEL and LOBE.unresolved (.exr)")


def main(args: argparse.Namespace) -> None:
    """Write the maps, their medians by region and a picture."""
    stack = Stack.open(args.stack)
    labels = read_labels(args.labels)
    material = read_material(args.material)
    if material.model != "slope":
        raise InputError(f"{args.material}: is of model {material.model}; give one of model slope")
    priors = slope.read_priors(args.prior)
    factors = trust.read(args.prior, [stack.lights[i] for i in samples.training_lights(stack)]).lights
    maps: dict[str, Map] = {}
    for box in stack.tiles():
        y0, y1, x0, x1 = box
        region = samples.cut(labels, box)
        part = material.part(slice(y0, y1), slice(x0, x1))
        tile = samples.read(stack, box).weighed(factors)
        for name, values in _tile(stack, part, tile, region, priors, args.threads).items():
            plane = maps.setdefault(name, np.zeros(labels.shape, np.float32))
            plane[y0:y1, x0:x1] = values.reshape(y1 - y0, x1 - x0)
        print(f"sigma: tile {y0},{x0}", file=sys.stderr, flush=True)
    write_exr(args.out, maps)
    regions = {region.name: labels == region.label for region in read_regions(args.regions)}
    write_json(args.summary, {name: summary(material, maps, inside) for name, inside in regions.items()})
    pictures.write_png(args.picture, picture(material, maps))


def _tile(
    stack: Stack,
    part: Material,
    tile: samples.Samples,
    region: NDArray[np.intp],
    priors: list[slope.Prior],
    threads: int,
) -> dict[str, Array]:
    """Maps (texel,) of one tile."""
    P, C = parameters(part)
    stiffness = np.stack([prior.stiffness() for prior in priors])[region]
    stiffness[C[:, :-1].max((1, 2)) <= 0] = 0  # a texture that was fitted without its prior
    covariance = np.empty((len(P), P.shape[1] + 3 * C.shape[1], P.shape[1] + 3 * C.shape[1]))
    for cell in near.cells(stack, tile.box, samples.training_lights(stack)):
        at = cell.at
        T = tile.T[at] if cell.factor is None else tile.T[at] / cell.factor[:, None]
        covariance[at] = uncertainty.covariances(
            P[at], C[at], T, tile.W[at], cell.lights, part.tail, stiffness[at], cell.slopes, threads
        )
    least = AT_BOUND * slope.resolution(stack.directions[samples.training_lights(stack)], part.lobes)
    return {**deviations(part, P, covariance), **unresolved(P, C, covariance, least)}


def parameters(material: Material) -> tuple[Array, Array]:
    """Shapes (texel, K) and colours (texel, lobes + 1, 3), in the stack's unit, that a slope material was made from."""
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
    return np.stack(shapes, 1), np.stack(colours, 1)


def deviations(material: Material, shapes: Array, covariance: Array) -> dict[str, Array]:
    """``sigma.CHANNEL`` (texel,) of each shape and colour; of a colour times its amplitude, in 1/sr."""
    maps = {}
    for k in range(material.lobes):
        at = slice(LOBE_SIZE * k, LOBE_SIZE * (k + 1))
        sd = propagated(covariance[:, at, at], _of_widths(shapes[:, at]))
        maps.update({f"sigma.lobe{k + 1}.{name}": sd[:, i] for i, name in enumerate(SHAPES["slope"])})
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
    """Standard deviations (texel, m) of values with these derivatives (texel or 1, m, n) by the parameters."""
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


def unresolved(shapes: Array, colours: Array, covariance: Array, least: float) -> dict[str, Array]:
    """``LOBE.unresolved`` (texel,): 1 where the light grid cannot tell how wide a lobe is.

    It is no wider than `least`, half of the distance of two lights, along one of its axes; or the logarithm of its
    area has a standard deviation over 0.3.
    """
    maps = {}
    for k in range(colours.shape[1] - 1):
        at = LOBE_SIZE * k
        alpha, gamma = at + 2, at + 4
        V = covariance[:, [[alpha], [gamma]], [[alpha, gamma]]]
        unsure = ~(V.sum((1, 2)) < UNSURE**2)
        narrow = narrowest(shapes[:, at : at + LOBE_SIZE]) <= least
        there = colours[:, k].max(1) > 0
        maps[f"lobe{k + 1}.unresolved"] = (there & (narrow | unsure)).astype(float)
    return maps


def summary(material: Material, maps: dict[str, Map], inside: NDArray[np.bool_]) -> dict[str, dict[str, float | None]]:
    """Medians over the texels of a region that have the lobe: facets in degrees, colours relative to themselves."""
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
    """Standard deviation of a lobe's direction, in degrees."""
    x, y = (maps[f"sigma.{lobe}.{axis}"].astype(float) for axis in "xy")
    return np.asarray(np.degrees(np.arctan(np.hypot(x, y))))


def relative(material: Material, maps: dict[str, Map], lobe: str) -> Array:
    """Standard deviation of a lobe's strongest channel over its amplitude."""
    sd = np.max([maps[f"sigma.{lobe}.{c}"] for c in "RGB"], axis=0)
    return np.asarray(sd / np.maximum(material.channels[f"{lobe}.amplitude"], 1e-12), float)


def _median(values: Array) -> float | None:
    middle = float(np.median(values))
    return float(f"{middle:.4g}") if math.isfinite(middle) else None


def picture(material: Material, maps: dict[str, Map]) -> pictures.Picture:
    """A row a lobe."""
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
    """Nothing where there is no lobe; what has no bound is as large as can be shown."""
    return np.where(there, np.minimum(np.nan_to_num(values, posinf=1e9), 1e9), 0)
