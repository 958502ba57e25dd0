"""A 12-bit Bayer sensor behind a mechanical shutter: counts of radiance, faults included."""

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
    """Sensor of a 12-bit camera of the paper's kind; its numbers are made up.

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
    brightest
        Radiance (π·T) of green that fills the well in 1/4096 s under nominal light.
    prnu
        Relative standard deviation of the pixels' response.
    hot
        Share of pixels with a dark current of thousands of electrons a second.
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
    black: int = 256
    black_drift: float = 0.3
    brightest: float = 18.0
    prnu: float = 0.003
    hot: float = 0.0005
    flicker: float = 0.001
    glare: float = 0.0
    vignetting: float = 0.0
    banding: float = 0.0

    @property
    def clip(self) -> int:
        """Count of a full well, under 4095."""
        return self.black + int(self.full_well / self.gain)

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
        (2 h + BORDER, 2 w) uint16
            Counts, top row first; the masked rows come first.
        """
        height, width = radiance.shape[:2]
        shape = (2 * height + BORDER, 2 * width)
        response, dark = _defects(self, shape, pixels)
        rng = np.random.Generator(np.random.SFC64(np.random.SeedSequence(shot.tolist())))
        light = np.zeros(shape, np.float32)
        camera = radiance @ CROSSTALK.T.astype(np.float32)
        for row, column, channel in SITES:
            light[BORDER + row :: 2, column::2] = camera[..., channel]
        if self.glare or self.vignetting or self.banding:
            light[BORDER:] = self._faults(light[BORDER:], camera, seconds)
        light *= np.float32(self.rate * seconds * lamp * max(0.0, 1 + self.flicker * rng.standard_normal()))
        electrons = np.minimum(light * response + dark * np.float32(seconds), 4 * self.full_well)
        noisy = rng.poisson(electrons) + self.read * rng.standard_normal(shape, np.float32)
        black = self.black + self.black_drift * rng.standard_normal()
        counts = np.minimum(noisy, self.full_well) / self.gain + black
        return np.clip(np.floor(counts + 0.5), 0, self.clip).astype(np.uint16)

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
    dark = np.where(rng.random(shape) < sensor.hot, current, 20.0)
    return response, dark.astype(np.float32)


def shutter(nominal: float) -> float:
    """Return the true time in seconds of a nominal shutter time: the nearest third stop with an error of the curtains.

    Nominal 1/25, 1/100, 1/250 s are 1/25.4, 1/101.6, 1/256 s; the error grows to 1.5 % at 1/4000 s, which is made up.
    """
    stop = round(3 * math.log2(1 / nominal))
    digest = hashlib.sha256(str(stop).encode()).digest()
    error = (digest[0] / 127.5 - 1) * 0.015 * min(1.0, 1 / (nominal * 4000))
    return 2.0 ** (-stop / 3) * (1 + error)
