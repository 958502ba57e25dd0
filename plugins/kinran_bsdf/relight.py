"""Pictures of a whole material at the measured view under lights, and its albedo, in NumPy."""

import numpy as np
from numpy.typing import ArrayLike

from kinran_bsdf.arrays import Array, Map
from kinran_bsdf.colours import TO_REC709
from kinran_bsdf.material import Material
from kinran_bsdf.models.lambert import diffuse, diffuse_albedo, diffuse_lift
from kinran_bsdf.models.model import grazing
from kinran_bsdf.residual import relit


def relight(material: Material, lights: ArrayLike) -> Map:
    """Return pictures of a fabric at the measured view V = N under directional lights.

    The albedo clamp `bound` is not applied: the pictures are those that were fitted.

    Parameters
    ----------
    material
        Maps of the fabric.
    lights : (n, 3) float
        Unit directions of the lights, away from the surface.

    Returns
    -------
    (n, H, W, 3) float32
        π T in the RGB of the radiance stack (by the inverse of `from_stack`); row 0 is v = 0.
    """
    directions = np.atleast_2d(np.asarray(lights, np.float64))
    height, width = material.size
    images = np.empty((len(directions), height, width, 3), np.float32)
    rows = max(1, (1 << 16) // width)  # a block stays in the cache while all lights pass over it
    for top in range(0, height, rows):
        block = slice(top, min(top + rows, height))
        terms = _terms(material, block)
        for k, light in enumerate(directions):
            images[k, block] = _radiance(material, terms, light)
        if material.residual is not None:
            maps = material.residual_maps(block)
            for k, factors in enumerate(material.residual.basis(directions)):
                images[k, block] = relit(images[k, block], material.residual, maps, factors)
    return images


def relight_texels(material: Material, lights: ArrayLike, view: ArrayLike) -> Map:
    """Return pictures of all terms of a fabric, each texel under its own lights and seen from its own direction.

    Near N these are the pictures that the lobes were fitted to, without the extrapolation of `Model.lobe`.

    Parameters
    ----------
    material
        Maps of the fabric; its residual is left out.
    lights : (n, H, W, 3) float
        Unit directions towards the lights.
    view : (H, W, 3) float
        Unit directions towards the camera.

    Returns
    -------
    (n, H, W, 3) float32
        π T in the RGB of the radiance stack; row 0 is v = 0.
    """
    (colour, (x, y)), *lobes = _terms(material, slice(None))
    towards = np.moveaxis(np.asarray(view, np.float32), -1, 0)
    images = np.empty((len(np.asarray(lights)), *material.size, 3), np.float32)
    for k, light in enumerate(np.moveaxis(np.asarray(lights, np.float32), -1, 1)):
        images[k] = colour * diffuse(tuple(light), x, y)[..., None]
        for strength, shape in lobes:
            images[k] += strength * material.reflection.value(towards, light, shape)[..., None]
    return images


def _terms(material: Material, rows: slice) -> list[tuple[Map, Map]]:
    """Return each term's π · colour · amplitude (h, W, 3) in the stack's RGB, and its shape (n, h, W)."""
    back = np.linalg.inv(material.from_stack).T.astype(np.float32) * np.float32(np.pi)
    return [(c @ back, np.ascontiguousarray(np.moveaxis(s, -1, 0))) for c, s in material.terms(rows)]


def _radiance(material: Material, terms: list[tuple[Map, Map]], light: Array) -> Map:
    view, l = (0.0, 0.0, 1.0), tuple(float(v) for v in light)  # noqa: E741 (the field's letter)
    if l[2] <= 0:
        return np.zeros_like(terms[0][0])
    floor = grazing(material.theta_max)
    (colour, (x, y)), *lobes = terms
    result = colour * diffuse_lift(view, l, x, y, floor)[..., None]
    for colour, shape in lobes:
        result += colour * material.reflection.lobe(view, l, shape, floor)[..., None]
    return result


def albedo(material: Material, nodes: int = 24) -> Map:
    """Return the albedo at V = N of each texel: ∫ T dω over the lights above the horizon.

    Parameters
    ----------
    material
        Maps of the fabric; its residual is left out.
    nodes
        Number of quadrature nodes per dimension, placed where the lobe is.

    Returns
    -------
    (H, W, 3) float32, ACEScg
    """
    (colour, slopes), *lobes = material.terms()
    total = colour * diffuse_albedo(slopes[..., 0], slopes[..., 1])[..., None]
    for colour, shape in lobes:
        total += colour * material.reflection.integral(np.moveaxis(shape, -1, 0), nodes)[..., None]
    return total.astype(np.float32)


def clamp(material: Material) -> Map:
    """Return the channel `bound`: the factor (H, W) in (0, 1] that brings the albedo at V = N to at most 1.

    The limit holds in each band of ACEScg and of Rec. 709, in which saturated colours have larger components.
    """
    there = albedo(material)
    peak = np.maximum(there.max(-1), (there @ TO_REC709.T).max(-1))
    return (1 / np.maximum(peak, 1)).astype(np.float32)
