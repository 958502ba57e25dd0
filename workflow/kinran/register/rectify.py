"""Bring every view to the fabric's plane by one resampling through its height, and measure the shift that is left."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from kinran.base.files import InputError
from kinran.register.cameras import Cameras
from kinran.register.target import CENTRE

Array = NDArray[np.float64]
Image = NDArray[np.float32]

PATCH, STEP = 64, 48
"""Side in texels of the patches whose shift is measured, and distance from one to the next: large enough for a texture,
small enough for many. The floor below is measured with them."""
RESPONSE = 0.4
"""Height of the correlation's peak, 1 for equal patches, below which a patch has no texture in common. No measurement
stands behind the height."""
FLOOR = 0.07
"""Least shift that can be told, in pixels of the front view: the median that is measured at 60° between views that are
registered by the true surface of a simulated session, where the light on the gold differs from view to view."""


@dataclass(frozen=True)
class Grid:
    """Texels on the fabric's plane, around the middle of the board; row 0 is v = 0, the lowest.

    Attributes
    ----------
    width, height
        Size in texels.
    texel
        Side of a texel in mm.
    """

    width: int
    height: int
    texel: float

    @property
    def x(self) -> Array:
        """X of the columns in mm."""
        return np.asarray((np.arange(self.width) + 0.5 - self.width / 2) * self.texel)

    @property
    def y(self) -> Array:
        """Y of the rows in mm."""
        return np.asarray((np.arange(self.height) + 0.5 - self.height / 2) * self.texel)

    def surface(self, height: Array) -> Array:
        """Points (y, x, 3) in mm of a height map (y, x)."""
        x, y = np.meshgrid(self.x, self.y)
        return np.stack([x, y, height], -1)


def grid_of(cameras: Cameras, field: tuple[float, float]) -> Grid:
    """Grid over a field (width, height in mm), as fine as the front view sees it."""
    texel = cameras.pixel_mm(0)
    return Grid(round(field[0] / texel), round(field[1] / texel), texel)


def check_inside(cameras: Cameras, grid: Grid) -> None:
    """Check that every view sees the whole field.

    Raises
    ------
    InputError
        A corner of the field is outside a picture.
    """
    outline = grid.surface(np.zeros((grid.height, grid.width)))[[0, 0, -1, -1], [0, -1, 0, -1]]
    for view, name in enumerate(cameras.names):
        pixels = cameras.project(view, outline)
        if (pixels < CENTRE).any() or (pixels > np.array([cameras.width, cameras.height]) - CENTRE).any():
            raise InputError(
                f"{name}: does not show the whole field of {grid.width * grid.texel:.1f} x "
                f"{grid.height * grid.texel:.1f} mm; give a smaller --field-mm, or leave the view out"
            )


def rectify(cameras: Cameras, view: int, picture: Image, grid: Grid, height: Array) -> Image:
    """Resample a view at the texels of the surface.

    Parameters
    ----------
    cameras, view
        Calibrated cameras, and the index of the view.
    picture : (y, x) or (y, x, channel) float32
        Linear light, **top row first**, as the camera gave it: nothing is resampled before or after.
    grid
        Texels of the surface.
    height : (y, x) float
        Height of each texel in mm.

    Returns
    -------
    (y, x) or (y, x, channel) float32
        Linear light by cubic interpolation; row 0 is v = 0.
    """
    pixels = cameras.project(view, grid.surface(height)) - CENTRE
    return sample(picture, pixels)


def sample(picture: Image, pixels: Array) -> Image:
    """Cubic interpolation of a picture at positions (…, 2) that count the first pixel's middle as (0, 0)."""
    x, y = (np.ascontiguousarray(pixels[..., k], np.float32) for k in range(2))
    return np.asarray(cv2.remap(picture, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE), np.float32)


def shifts(one: Image, other: Image, texel: float) -> Array:
    """Shift between two pictures of the same texels, patch by patch, by phase correlation.

    The cross-power spectrum is divided by the square root of its magnitude, not by all of it: that gives the
    frequencies in which the patches hold nothing but noise less to say. The peak is then found between the texels by
    the Fourier series itself [GuizarSicairos2008]: a parabola through three texels would pull it towards the middle.

    Parameters
    ----------
    one, other : (y, x) float32
        Grey pictures.
    texel
        Side of a texel in mm.

    Returns
    -------
    (patch,) float
        Lengths in mm; NaN where the two have no texture in common.
    """
    size = min(PATCH, *one.shape)
    window = np.outer(np.hanning(size), np.hanning(size))
    found = []
    for y in range(0, one.shape[0] - size + 1, STEP):
        for x in range(0, one.shape[1] - size + 1, STEP):
            p, q = (a[y : y + size, x : x + size].astype(float) for a in (one, other))
            shift, response = _shift((p - p.mean()) * window, (q - q.mean()) * window)
            found.append(np.hypot(*shift) * texel if response > RESPONSE else np.nan)
    return np.array(found)


def _shift(p: Array, q: Array) -> tuple[tuple[float, float], float]:
    """Shift (x, y) in texels from one windowed patch to another, and the peak's height."""
    spectrum = np.fft.fft2(p).conj() * np.fft.fft2(q)
    root = np.sqrt(np.abs(spectrum))
    spectrum /= root + 1e-12 * root.max() + 1e-30
    size = p.shape[0]
    middle = size // 2
    peak = np.fft.fftshift(np.fft.ifft2(spectrum).real)
    y, x = (float(k - middle) for k in np.unravel_index(peak.argmax(), peak.shape))
    frequencies = 2j * np.pi * np.fft.fftfreq(size)
    for step in (0.1, 0.01):
        around = step * np.arange(-10, 11)
        waves_y, waves_x = (np.exp(np.outer(k + around, frequencies)) for k in (y, x))
        fine = (waves_y @ spectrum @ waves_x.T).real
        i, j = np.unravel_index(fine.argmax(), fine.shape)
        y, x = y + float(around[i]), x + float(around[j])
    return (x, y), float(fine.max() / (root.sum() + 1e-30))
