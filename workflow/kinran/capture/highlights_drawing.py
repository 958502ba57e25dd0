"""Picture of the spheres in all photographs, with their outlines and the highlights that were found."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pillow
from PIL import ImageDraw

from kinran.base.pictures import Picture, sheet
from kinran.capture.circles import Circle

Image = NDArray[np.float32]

TILE = 150
"""Width of the picture of a sphere in pixels."""
WIDTH = 10
"""Most photographs in a row."""
BRIGHT = 95
"""Percentile of a tile that becomes white, so that a dark sphere's outline is seen."""
LETTERS = 24
"""Most letters of a caption over a tile."""
SEEN, WRONG = (90, 200, 90), (230, 80, 60)
"""Colours of the marks where a lamp was found, and where none was."""


@dataclass(frozen=True)
class SeenSphere:
    """A sphere as a photograph shows it.

    Attributes
    ----------
    picture : (y, x)
        The square around it, in units of white, the top row first.
    circle, inside
        Its outline in the whole photograph, and in `picture`.
    spot
        Place (x, y) of the highlight in `picture`; None where there is none.
    """

    picture: Image
    circle: Circle
    inside: Circle
    spot: tuple[float, float] | None

    @property
    def spot_in_photograph(self) -> tuple[float, float]:
        """Place (x, y) of the highlight in the whole photograph, in pixels from the top left."""
        if self.spot is None:
            raise ValueError("has no highlight")
        factor = self.circle.radius / self.inside.radius
        x, y = (a - b for a, b in zip(self.spot, (self.inside.x, self.inside.y), strict=True))
        return self.circle.x + factor * x, self.circle.y + factor * y


@dataclass(frozen=True)
class Photograph:
    """What a photograph shows of the spheres; `fault` says why it is no light, and is empty where it is one."""

    name: str
    spheres: list[SeenSphere]
    fault: str = ""


def drawing(photographs: list[Photograph]) -> Picture:
    """Return a sheet of all photographs in their order: a tile for each sphere, with its outline and its highlight."""
    tiles = []
    for photograph in photographs:
        for k, sphere in enumerate(photograph.spheres):
            name = photograph.name if len(photograph.spheres) == 1 else f"{photograph.name}, sphere {k + 1}"
            caption = "left out: " + photograph.name if photograph.fault else name
            tiles.append((caption[:LETTERS], _tile(sphere, bool(photograph.fault))))
    return sheet([tiles[k : k + WIDTH] for k in range(0, len(tiles), WIDTH)])


def _tile(sphere: SeenSphere, wrong: bool) -> Picture:
    bright = max(float(np.percentile(sphere.picture, BRIGHT)), 1e-6)
    codes = (255 * np.sqrt(np.clip(sphere.picture / bright, 0, 1))).astype(np.uint8)
    size = (TILE, TILE)
    scale = TILE / codes.shape[1], TILE / codes.shape[0]
    image = Pillow.fromarray(codes).resize(size).convert("RGB")
    draw, colour = ImageDraw.Draw(image), WRONG if wrong else SEEN
    at, radius = (sphere.inside.x * scale[0], sphere.inside.y * scale[1]), sphere.inside.radius * scale[0]
    draw.circle(at, radius, outline=colour)
    if sphere.spot is not None:
        x, y = sphere.spot[0] * scale[0], sphere.spot[1] * scale[1]
        for dx, dy in ((1, 0), (0, 1)):
            for side in (-1, 1):
                draw.line([(x + 4 * side * dx, y + 4 * side * dy), (x + 12 * side * dx, y + 12 * side * dy)], colour)
    return np.asarray(image)
