"""Surface normals from a stack: Lambert's law, by the samples that keep to it."""

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinran.exr import write_exr
from kinran.fit import samples
from kinran.stack import Stack

Array = NDArray[np.float64]
Single = NDArray[np.float32]

ROUNDS = 10
LEAST = 1e-3
"""Of the albedo: residuals below count as this much."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the stage."""
    parser.add_argument("--stack", type=Path, required=True, help="radiance stack (.zarr)")
    parser.add_argument("out", type=Path, help="normals (.exr): x, y, z")


def main(args: argparse.Namespace) -> None:
    """Write the normals of all texels, by the training lights."""
    stack = Stack.open(args.stack)
    lights = samples.training_directions(stack)
    normals = np.zeros((stack.height, stack.width, 3), np.float32)
    for tile in samples.iterate(stack, stack.tiles()):
        y0, y1, x0, x1 = tile.box
        normals[y0:y1, x0:x1] = fit(tile.T, tile.W, lights).reshape(y1 - y0, x1 - x0, 3)
    write_exr(args.out, {name: np.ascontiguousarray(normals[..., k]) for k, name in enumerate("xyz")})


def fit(T: Single, W: Single, lights: Array) -> Array:
    """Normals that leave the least sum of absolute residuals of Lambert's law.

    Highlights, cast shadows and light of neighbours are far from it and few: unlike least squares, the sum of absolute
    residuals hardly moves for them. Lights below the surface's own horizon say nothing. By reweighted least squares
    [Ikehata2012 compare norms of this problem].

    Parameters
    ----------
    T : (texel, 3, light) float32
    W : (texel, light) float32
        0 for what is not to be used.
    lights : (light, 3) float

    Returns
    -------
    (texel, 3) float
        Unit vectors; N where a texel is black or has too few samples.
    """
    y = T.mean(1).astype(float)
    use = (W > 0).astype(float)
    scaled = _solve(use, y, lights)
    for _ in range(ROUNDS):
        predicted = scaled @ lights.T
        floor = LEAST * np.linalg.norm(scaled, axis=1, keepdims=True) + 1e-12
        weight = use * (predicted > 0) / np.maximum(np.abs(y - predicted), floor)
        scaled = _solve(weight * floor, y, lights)
    length = np.linalg.norm(scaled, axis=1, keepdims=True)
    found = (length > 1e-9) & np.isfinite(length)
    return np.where(found, scaled / np.where(found, length, 1), [0.0, 0.0, 1.0])


def _solve(weight: Array, y: Array, lights: Array) -> Array:
    """Weighted least squares of y (texel, light) over the directions; (texel, 3)."""
    products = (lights[:, :, None] * lights[:, None]).reshape(len(lights), 9)
    normal = (weight @ products).reshape(-1, 3, 3)
    normal += (1e-9 * np.trace(normal, axis1=1, axis2=2) + 1e-30)[:, None, None] * np.eye(3)
    return np.asarray(np.linalg.solve(normal, ((weight * y) @ lights)[..., None])[..., 0])
