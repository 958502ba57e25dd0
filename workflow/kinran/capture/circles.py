"""Circles in pictures of one thing that is lit from many sides, found by the directions of its edges.

An outline stays where it is while shadows move. So the direction of the gradient is averaged over the pictures, each
with the same vote however bright it is, and a circle is where it points to one centre from all around.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage, optimize

Array = NDArray[np.float64]
Image = NDArray[np.float32]

FLOOR = 0.004
"""Gradient of the root of encoded light, a pixel, that counts half. The darkest step of 8 bits is 0.06 in roots, and a
sphere may differ from what is behind it by that step alone (`chrome` of xiumingzhang/photometric-stereo). With 0.016
the outline there was 22 pixels off; without the root, that of DiLiGenT's ball, in linear light, was 2.4 pixels off."""
TEXTURE = 1.5
"""Gradient that counts half, as a multiple of a picture's median: edges count that stand out of its texture and noise.
A choice."""
RADII = 8.0, 16.0
"""Radii in pixels that are looked for in each size of the pictures; each size is half the one before."""
BLUR, RING = 0.7, 0.8
"""Standard deviations in pixels of the filter of the gradient, and of the width of a ring: about a pixel of width, as
narrow as a sampled edge is."""
OUTER = 1.45
"""Largest ratio of a sphere's radius to that of the strongest circle on it. A mirror shows the plane that it lies on
around a black middle, from 45° of its surface on, which is at 0.71 of its radius."""
STRONG = 0.4
"""Share of the strongest circle's support that the outline has at least. On path-traced chrome the outline has 0.75 to
0.9 of it, and chance beyond the outline less than 0.1."""
ANGLES = np.linspace(0, 2 * np.pi, 360, endpoint=False)


@dataclass(frozen=True)
class Circle:
    """A circle in a photograph, in pixels from the top left."""

    x: float
    y: float
    radius: float

    def __str__(self) -> str:
        return f"{round(self.x, 2):g},{round(self.y, 2):g},{round(self.radius, 2):g}"

    def scaled(self, factor: float, left: float = 0.0, top: float = 0.0) -> "Circle":
        """Return the circle in a picture whose pixels are `1 / factor` as wide, and that begins at (left, top)."""
        return Circle((self.x - left) * factor, (self.y - top) * factor, self.radius * factor)


@dataclass(frozen=True)
class Candidate:
    """A circle that may be an outline.

    Attributes
    ----------
    support
        Mean over the circle of how surely its edge is seen, from 0 to 1.
    coherence
        Share of all edges on the circle that point to its centre, from 0 to 1.
    """

    circle: Circle
    support: float
    coherence: float


def edges(picture: Image) -> Array:
    """Return cos 2φ and sin 2φ (2, y, x) of the direction φ of the gradient, times a weight in [0, 1] of its size."""
    root = np.sqrt(np.maximum(picture, 0), dtype=float)
    across = ndimage.gaussian_filter(root, BLUR, order=(0, 1), mode="nearest")
    down = ndimage.gaussian_filter(root, BLUR, order=(1, 0), mode="nearest")
    energy = across**2 + down**2
    weight = 1 / (energy + max(FLOOR, TEXTURE * math.sqrt(float(np.median(energy)))) ** 2)
    return np.stack([(across**2 - down**2) * weight, 2 * across * down * weight])


def binned(picture: Image, factor: int) -> Image:
    """Return the means of squares of `factor` pixels of a picture (y, x)."""
    height, width = picture.shape[0] // factor, picture.shape[1] // factor
    whole = picture[: height * factor, : width * factor].reshape(height, factor, width, factor)
    return np.asarray(whole.mean((1, 3), dtype=np.float32))


def find_circles(field: Array, least: float, most: int) -> list[Candidate]:
    """Return the circles of `RADII` in averaged edges (2, y, x) with a support of at least `least`, the best first."""
    radii = np.arange(RADII[0], RADII[1] + 0.1, 0.5)
    response = _ring_response(field, radii[radii < min(field.shape[1:]) / 2])
    found: list[Candidate] = []
    while response.size and len(found) < most:
        k, y, x = np.unravel_index(int(np.argmax(response)), response.shape)
        if response[k, y, x] < least:
            break
        circle = Circle(float(x) + 0.5, float(y) + 0.5, float(radii[k]))
        towards, whole = _along(field, circle)
        coherence = float(towards.sum() / max(whole.sum(), 1e-12))
        found.append(Candidate(circle, float(response[k, y, x]), coherence))
        near = int(circle.radius / 4) + 1
        response[:, max(0, y - near) : y + near + 1, max(0, x - near) : x + near + 1] = -1
    return found


def outermost(field: Array, circle: Circle) -> Circle:
    """Return the outermost of the circles around the same centre, up to `OUTER` times as large, that are `STRONG`."""
    radii = np.arange(0.85 * circle.radius, OUTER * circle.radius, 0.5)
    response = _ring_response(field, radii[radii < min(field.shape[1:]) / 2])
    y, x = np.mgrid[: field.shape[1], : field.shape[2]] + 0.5
    response[:, np.hypot(x - circle.x, y - circle.y) > 0.25 * circle.radius] = -1
    best = response.max((1, 2))
    peaks = (best >= ndimage.maximum_filter1d(best, 3)) & (best > STRONG * best.max())
    k = int(np.flatnonzero(peaks)[-1])
    top, left = np.unravel_index(int(np.argmax(response[k])), response[k].shape)
    return Circle(float(left) + 0.5, float(top) + 0.5, float(radii[k]))


def polished(field: Array, circle: Circle) -> Circle:
    """Return the circle near another that has the most support, to a fraction of a pixel."""
    found = np.array([circle.x, circle.y, circle.radius])
    for blur in (0.03, 0.01, 0.0):  # in radii, so that the narrow peak is found from some pixels away
        smooth = ndimage.gaussian_filter(field, (0, *(2 * [max(blur * circle.radius, 0.5)])))
        steps = max(0.02 * circle.radius, 0.5) * np.vstack([np.zeros(3), np.eye(3)])
        found = optimize.minimize(
            lambda at, smooth=smooth: -_along(smooth, Circle(*at))[0].mean(),
            found,
            method="Nelder-Mead",
            options={"initial_simplex": found + steps, "xatol": 0.01, "fatol": 1e-5},
        ).x
    return Circle(*map(float, found))


def _along(field: Array, circle: Circle) -> tuple[Array, Array]:
    """Return the edges on a circle, at `ANGLES`: their part that points to its centre, and their whole weight."""
    at = [circle.y - 0.5 + circle.radius * np.sin(ANGLES), circle.x - 0.5 + circle.radius * np.cos(ANGLES)]
    cosine, sine = (ndimage.map_coordinates(part, at, order=1) for part in field)
    return cosine * np.cos(2 * ANGLES) + sine * np.sin(2 * ANGLES), np.hypot(cosine, sine)


def _ring_response(field: Array, radii: Array) -> Array:
    """Return the support (radius, y, x) of the circle of each radius around each pixel; -1 where it is not inside."""
    height, width = field.shape[1:]
    if not len(radii):
        return np.empty((0, height, width))
    margin = 2 * math.ceil(radii.max()) + 4
    shape = (fft.next_fast_len(height + margin, real=True), fft.next_fast_len(width + margin, real=True))
    cosine, sine = (fft.rfft2(part, shape) for part in field)
    y, x = fft.fftfreq(shape[0], 1 / shape[0])[:, None], fft.fftfreq(shape[1], 1 / shape[1])[None]
    angle, distance = np.arctan2(y, x), np.hypot(x, y)
    response = np.full((len(radii), height, width), -1.0)
    for k, radius in enumerate(radii):
        ring = np.exp(-0.5 * ((distance - radius) / RING) ** 2)
        ring /= ring.sum()
        spectrum = cosine * fft.rfft2(ring * np.cos(2 * angle)) + sine * fft.rfft2(ring * np.sin(2 * angle))
        near = math.ceil(radius)
        inside = np.s_[near : height - near, near : width - near]
        response[k][inside] = fft.irfft2(spectrum, shape)[inside]
    return response
