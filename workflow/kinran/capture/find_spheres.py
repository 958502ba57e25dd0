"""Mirror spheres beside a fabric, found in its photographs: a circle that stays, with a highlight that moves."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinran.base.files import InputError
from kinran.base.log import progress
from kinran.capture.circles import RADII, Candidate, Circle, binned, edges, find_circles, outermost, polished
from kinran.capture.lamp_spots import NoLampError, brightness, cut_out, lamp_spot

Array = NDArray[np.float64]
Image = NDArray[np.float32]

WIDTH, SPOTS = 1024, 512
"""Largest side in pixels of the pictures in which outlines, and highlights on them, are looked for. The smallest sphere
that is found is 1.6 % of it wide, less than any that is laid beside a fabric to be measured."""
LEAST_SUPPORT, LEAST_COHERENCE = 0.2, 0.8
"""Least support and coherence of an outline. Spheres had 0.23 to 0.93 and 0.91 to 1.00 (six path-traced sets, `chrome`
of xiumingzhang/photometric-stereo, the ball of DiLiGenT); circles with glints, on a glazed bunny and on a picture of 40
pixels, had coherences of 0.53 to 0.72."""
LEAST_SHARE = 0.75
"""Least share of the photographs that have a lamp's highlight within an outline: a set may hold some without a lamp."""
MOST = 40
"""Most circles of one size of the pictures that are looked at: a patterned fabric may have dozens."""


def find_spheres(paths: Sequence[Path]) -> list[Circle]:
    """Find the outlines of mirror spheres in photographs of one size, the largest first.

    Raises
    ------
    InputError
        There is none, or none that is seen surely enough.
    """
    fields: list[Array] = []
    small: list[NDArray[np.uint8]] = []
    for path in progress(paths, "spheres", "photographs"):
        picture = brightness(path)
        small.append(_brightest(picture, _factor(picture, SPOTS)))
        levels = [binned(picture, _factor(picture, WIDTH))]
        while min(levels[-1].shape) >= 4 * RADII[0]:
            levels.append(binned(levels[-1], 2))
        seen = [edges(level) / len(paths) for level in levels]
        fields = [a + b for a, b in zip(fields, seen, strict=True)] if fields else seen
    factor, reduced = _factor(picture, WIDTH), _factor(picture, SPOTS)
    found: list[tuple[Candidate, int]] = []
    for level, field in enumerate(fields):
        found += [(one, level) for one in find_circles(field, LEAST_SUPPORT, MOST) if one.coherence > LEAST_COHERENCE]
    usual = np.float32(1 / 255) * np.median(small, axis=0).astype(np.float32)
    spheres: list[Circle] = []
    for candidate, level in sorted(found, key=lambda pair: -pair[0].support):
        circle = candidate.circle.scaled(factor * 2**level)
        if any(math.hypot(circle.x - s.x, circle.y - s.y) < max(circle.radius, s.radius) for s in spheres):
            continue
        lamps = sum(_has_lamp(np.float32(1 / 255) * picture, usual, circle.scaled(1 / reduced)) for picture in small)
        if lamps >= LEAST_SHARE * len(paths):
            finer = max(level - 1, 0)
            spheres.append(outermost(fields[finer], circle.scaled(1 / factor / 2**finer)).scaled(factor * 2**finer))
    if not spheres:
        raise InputError(
            f"{paths[0].parent}: shows no mirror sphere whose outline and highlights are sure; give it by --sphere"
            " X,Y,RADIUS"
        )
    return sorted(_at_full_size(paths, spheres), key=lambda circle: -circle.radius)


def _factor(picture: Image, side: int) -> int:
    """Return by how much a picture is reduced to fit a square."""
    return max(1, math.ceil(int(max(picture.shape)) / side))


def _brightest(picture: Image, factor: int) -> NDArray[np.uint8]:
    """Return the brightest of each square of `factor` pixels, in 8 bits: so a highlight of a pixel is kept."""
    height, width = picture.shape[0] // factor, picture.shape[1] // factor
    squares = picture[: height * factor, : width * factor].reshape(height, factor, width, factor)
    return np.asarray(255 * np.clip(squares.max((1, 3)), 0, 1), np.uint8)


def _has_lamp(picture: Image, usual: Image, circle: Circle) -> bool:
    try:
        lamp_spot(cut_out(picture, circle)[0], *cut_out(usual, circle))
    except NoLampError:
        return False
    return True


def _at_full_size(paths: Sequence[Path], circles: Sequence[Circle]) -> list[Circle]:
    """Return circles that were found in reduced photographs to a fraction of a pixel."""
    room = 1.3
    sums = [np.zeros(()) for _ in circles]
    for path in progress(paths, "outlines", "photographs"):
        picture = brightness(path)
        sums = [a + edges(cut_out(picture, circle, room)[0]) for a, circle in zip(sums, circles, strict=True)]
    exact = []
    for field, circle in zip(sums, circles, strict=True):
        inside = cut_out(picture, circle, room)[1]
        found = polished(field / len(paths), inside)
        factor = circle.radius / inside.radius
        exact.append(
            Circle(
                circle.x + factor * (found.x - inside.x),
                circle.y + factor * (found.y - inside.y),
                factor * found.radius,
            )
        )
    return exact
