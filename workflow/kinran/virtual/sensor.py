"""A Bayer sensor behind a mechanical shutter: counts of radiance, faults included."""

import hashlib
import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]

CROSSTALK = np.array([[0.62, 0.27, 0.04], [0.14, 0.79, 0.12], [0.02, 0.20, 0.66]])
"""Linear Rec. 709 to the camera's R, G, B: made up, so that white reads most in green, as with real cameras, and the
calibration has a matrix to find."""
BORDER = 8
"""Rows above the picture that a mask covers."""
SITES = ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2))
"""Row, column and camera channel of the sites of a superpixel (RGGB)."""


@dataclass(frozen=True)
class Sensor:
    """Sensor of a camera; its numbers are made up, unless told of 12 bits and the paper's kind.

    Attributes
    ----------
    full_well
        Electrons at the highest count.
    gain
        Electrons per count.
    read
        Read noise in electrons.
    black, black_drift
        Black level in counts, and the standard deviation of its offset from frame to frame.
    site_black : (4,)
        What the black level of R, G1 (in R's rows), G2 and B differs by, in counts.
    row_drift, row_noise
        Root mean square in counts of the black level's slow wave over the rows, and of its steps from row to row; both
        are others in each frame.
    columns
        Columns left of the picture that a mask covers; an even number.
    brightest
        Radiance (π·T) of green that fills the well in 1/4096 s under nominal light.
    prnu
        Relative standard deviation of the pixels' response.
    hot, dark
        Share of pixels with a dark current of thousands of electrons a second, and that of the others.
    flicker
        Relative standard deviation of the lamp's light from frame to frame.
    glare
        Share of the picture's mean light that the lens spreads evenly over it.
    vignetting
        Relative loss of light in the corners.
    banding
        Exposure of the top rows relative to that of the middle, minus 1, at 1/4000 s; less at longer times.
    """

    full_well: float = 36_000.0
    gain: float = 10.4
    read: float = 12.0
    black: float = 256
    black_drift: float = 0.3
    site_black: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    row_drift: float = 0.0
    row_noise: float = 0.0
    columns: int = 0
    brightest: float = 18.0
    prnu: float = 0.003
    hot: float = 0.0005
    dark: float = 20.0
    flicker: float = 0.001
    glare: float = 0.0
    vignetting: float = 0.0
    banding: float = 0.0

    @property
    def clip(self) -> int:
        """Count of a full well."""
        return int(self.black) + int(self.full_well / self.gain)

    @property
    def rate(self) -> float:
        """Electrons a second at a site that sees unit radiance."""
        return self.full_well * 4096 / self.brightest

    def expose(
        self, radiance: Image, seconds: float, lamp: float, pixels: int, shot: NDArray[np.uint64]
    ) -> NDArray[np.uint16]:
        """Return the counts of one frame.

        Parameters
        ----------
        radiance : (h, w, 3) float32
            π·T under a lamp of unit output, linear Rec. 709, top row first.
        seconds
            True shutter time in seconds.
        lamp
            Relative light of the lamp.
        pixels
            Seed of the sites' defects, which do not change from frame to frame.
        shot : (n,) uint64
            Seed of the noise of this frame.

        Returns
        -------
        (2 h + BORDER, columns + 2 w) uint16
            Counts, top row first; the masked rows and columns come first.
        """
        height, width = radiance.shape[:2]
        shape = (2 * height + BORDER, self.columns + 2 * width)
        response, dark = _defects(self, shape, pixels)
        rng = np.random.Generator(np.random.SFC64(np.random.SeedSequence(shot.tolist())))
        light = np.zeros(shape, np.float32)
        camera = radiance @ CROSSTALK.T.astype(np.float32)
        for row, column, channel in SITES:
            light[BORDER + row :: 2, self.columns + column :: 2] = camera[..., channel]
        if self.glare or self.vignetting or self.banding:
            light[BORDER:, self.columns :] = self._faults(light[BORDER:, self.columns :], camera, seconds)
        light *= np.float32(self.rate * seconds * lamp * max(0.0, 1 + self.flicker * rng.standard_normal()))
        electrons = np.minimum(light * response + dark * np.float32(seconds), 4 * self.full_well)
        noisy = rng.poisson(electrons) + self.read * rng.standard_normal(shape, np.float32)
        black = self.black + self.black_drift * rng.standard_normal()
        counts = np.minimum(noisy, self.full_well) / self.gain + self._black(shape, black, rng)
        return np.clip(np.floor(counts + 0.5), 0, self.clip).astype(np.uint16)

    def _black(self, shape: tuple[int, int], level: float, rng: np.random.Generator) -> Image | float:
        """Return the black level (2 h + BORDER, columns + 2 w) of a frame; a number where all sites have the same."""
        if not (any(self.site_black) or self.row_drift or self.row_noise):
            return level
        black = np.full(shape, level, np.float32)
        for (row, column, _), differs in zip(SITES, self.site_black, strict=True):
            black[row::2, column::2] += differs
        if self.row_drift or self.row_noise:
            turns, start = rng.uniform(1, 3), rng.uniform(0, 1)
            wave = np.sqrt(2) * np.sin(2 * np.pi * (np.linspace(0, turns, shape[0]) + start))
            black += (self.row_drift * wave + self.row_noise * rng.standard_normal(shape[0]))[:, None].astype(
                np.float32
            )
        return black

    def _faults(self, light: Image, camera: Image, seconds: float) -> Image:
        """Return light (2 h, 2 w) with glare, vignetting and the travel of the curtains."""
        rows, columns = light.shape
        veil = np.zeros_like(light)
        for row, column, channel in SITES:
            veil[row::2, column::2] = self.glare * camera[..., channel].mean()
        y, x = np.linspace(1, -1, rows, dtype=np.float32)[:, None], np.linspace(-1, 1, columns, dtype=np.float32)
        lens = 1 - self.vignetting * (x**2 + y**2) / 2
        curtain = 1 + self.banding * y * min(1.0, 1 / (seconds * 4096))
        return np.asarray((light + veil) * lens * curtain, np.float32)


@lru_cache(maxsize=4)
def _defects(sensor: Sensor, shape: tuple[int, int], seed: int) -> tuple[Image, Image]:
    """Return relative response and dark current (electrons a second) of the sites."""
    rng = np.random.default_rng([seed, 1])
    response = 1 + sensor.prnu * rng.standard_normal(shape, np.float32)
    current = np.exp(rng.normal(np.log(30_000), 1.0, shape))
    dark = np.where(rng.random(shape) < sensor.hot, current, sensor.dark)
    return response, dark.astype(np.float32)


def shutter(nominal: float) -> float:
    """Return the true time in seconds of a nominal shutter time: the nearest third stop with an error of the curtains.

    Nominal 1/25, 1/100, 1/250 s are 1/25.4, 1/101.6, 1/256 s; the error grows to 1.5 % at 1/4000 s, which is made up.
    """
    stop = round(3 * math.log2(1 / nominal))
    digest = hashlib.sha256(str(stop).encode()).digest()
    error = (digest[0] / 127.5 - 1) * 0.015 * min(1.0, 1 / (nominal * 4000))
    return 2.0 ** (-stop / 3) * (1 + error)
