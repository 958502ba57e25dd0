"""The highlight of a lamp on a mirror sphere, and what is none."""

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from kinran.capture.circles import Circle, binned
from kinran.data.picture_file import read_picture

Image = NDArray[np.float32]

RIM = 0.8
"""Share of a sphere's radius in which highlights are looked for. A lamp at the horizon is mirrored at 0.71 of it where
the sphere is seen from straight above, and at 0.8 where it is seen 16° askew."""
LEAST_PEAK = 0.1
"""Least peak of a highlight, in units of white, over the median of all photographs: well over the noise of a photograph
and under any lamp that lights a fabric. No measurement stands behind it."""
WIDEST, BLOOM = 0.05, 25
"""Largest area of a highlight, as a share of the sphere's disc and, on top of it, in pixels. A lamp that is 50° wide
has that share, and a lens spreads the smallest lamp over some pixels. A choice."""
ALONE = 0.7
"""Least share of all that is over half the peak that one lamp has. A choice."""
GAIN = 4.0
"""Largest factor by which a photograph may be brighter than the median of all without its pattern counting as a
highlight. A choice."""
LARGEST = 128
"""Radius in pixels to which larger spheres are reduced: a twentieth of a pixel there is 0.05° of a lamp's direction."""


class NoLampError(ValueError):
    """A sphere in a photograph mirrors no lamp; the message says what is seen of it, after the photograph's name."""


def brightness(path: Path) -> Image:
    """Read the mean of R, G, B (y, x) of a photograph as it is encoded, in units of white, the top row first.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    picture = read_picture(path)
    return np.asarray(picture.values.mean(-1, dtype=np.float32) / np.float32(picture.ceiling or 1))


def cut_out(picture: Image, circle: Circle, room: float = 1.0) -> tuple[Image, Circle]:
    """Return the square around a circle, `room` times as wide, and the circle in it; reduced where over `LARGEST`."""
    half = room * circle.radius + 1
    left, top = max(math.floor(circle.x - half), 0), max(math.floor(circle.y - half), 0)
    factor = max(1, math.ceil(circle.radius / LARGEST))
    part = picture[top : math.ceil(circle.y + half), left : math.ceil(circle.x + half)]
    return binned(part, factor), circle.scaled(1 / factor, left, top)


def lamp_spot(picture: Image, usual: Image, circle: Circle) -> tuple[float, float]:
    """Return the centre (x, y) of a lamp's highlight within a circle, down to half its peak.

    Parameters
    ----------
    picture, usual : (y, x)
        A photograph, and the median of all photographs of the set, in units of white.
    circle
        Outline of the sphere.

    Raises
    ------
    NoLampError
        No spot is brighter than `LEAST_PEAK`, or it is too wide for a lamp's, or one of several.
    """
    y, x = np.mgrid[: picture.shape[0], : picture.shape[1]] + 0.5
    inside = np.hypot(x - circle.x, y - circle.y) < RIM * circle.radius
    gain = np.clip(np.median(picture[inside]) / max(float(np.median(usual[inside])), 1e-9), 1, GAIN)
    bright = np.where(inside, picture - gain * usual, 0)
    peak = float(bright.max())
    if peak < LEAST_PEAK:
        raise NoLampError("has no highlight on the sphere")
    spots, _ = ndimage.label(bright > peak / 2)
    areas = np.bincount(spots.ravel())[1:]
    largest = int(areas.argmax())
    if areas[largest] > WIDEST * math.pi * circle.radius**2 + BLOOM:
        raise NoLampError("has no compact highlight on the sphere")
    if areas[largest] < ALONE * areas.sum():
        raise NoLampError("has several highlights on the sphere")
    weight = np.where(spots == largest + 1, bright, 0)
    return float((weight * x).sum() / weight.sum()), float((weight * y).sum() / weight.sum())
