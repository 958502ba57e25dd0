"""Radiance that a material predicts for a stack."""

import numpy as np
from numpy.typing import NDArray

from kinran.base import distances
from kinran.data import texel_directions
from kinran.data.radiance_stack import Box, Stack
from kinran_bsdf.material import Material
from kinran_bsdf.relight import relight, relight_texels
from kinran_bsdf.residual import relit


def predict(material: Material, stack: Stack, box: Box, lights: NDArray[np.intp]) -> NDArray[np.float32]:
    """Predict the radiance of a tile of a stack.

    Where `texel_directions.matters`, each texel has its own directions of light and view, and the lamps' falloff.

    Parameters
    ----------
    material
        Material of the whole fabric.
    stack
        The stack.
    box
        The tile (y0, y1, x0, x1) in texels.
    lights : (light,) int
        Indices of lights of the stack.

    Returns
    -------
    (light, y, x, 3) float32
        Radiance in the stack's unit.
    """
    y0, y1, x0, x1 = box
    part = material.part(slice(y0, y1), slice(x0, x1))
    if not texel_directions.matters(stack):
        return relight(part, stack.directions[lights])
    assert stack.texel_mm
    points = distances.texel_points(stack.height, stack.width, stack.texel_mm)[y0:y1, x0:x1]
    positions = [np.array(stack.lights[i].position_mm, float) for i in lights]
    view = distances.directions_to(stack.camera_mm or texel_directions.AFAR, points)
    images = relight_texels(part, [distances.directions_to(p, points) for p in positions], view)
    images *= distances.falloff(positions, points)[..., None].astype(np.float32)
    if part.residual is not None:
        maps = part.residual_maps()
        factors = part.residual.basis(stack.directions[lights])
        images = np.stack([relit(image, part.residual, maps, f) for image, f in zip(images, factors, strict=True)])
    return images
