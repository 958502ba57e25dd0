"""The paper's four steps (Takeda2008, §3.2), to the letter, for all texels of a block at once."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinran.base import frames
from kinran.data.texel_directions import Under
from kinran.fit.fitted_model import Channels, named
from kinran.fit.samples import Samples

Array = NDArray[np.float64]

FLOOR = 0.05
"""Share of the peak below which samples do not enter the widths: their logarithm is noise. A choice; the paper names
none."""
FLAT = 20.0
"""Width dp, in radians, of a lobe without an azimuth, as one at the pole is: nearly constant over φ. A choice."""


@dataclass(frozen=True)
class TakedaFit:
    """Parameters of Eq. 3: shapes (texel, 4) θ_n, φ_n, dt, dp in radians, and colours (texel, 2, 3) C_s, C_d."""

    shapes: Array
    colours: Array
    numbers: float = 10
    shared: int = 0

    def predict(self, under: Under) -> NDArray[np.float32]:
        """T (texel, 3, light) under some lights, without falloff, in the unit of the samples."""
        T = np.empty((len(self.shapes), 3, under.count), np.float32)
        for k, at in under.cells():
            # of slopes (x, y) the angles are those of (x, y, 1)
            theta_h, phi_h = frames.angles(np.concatenate([under.slopes[k], np.ones((under.count, 1))], 1))
            theta, phi, dt, dp = self.shapes[at].T[..., None]
            a, b = (theta_h - theta) / dt, frames.wrap(phi_h - phi) / dp
            C_s, C_d = self.colours[at][:, 0, :, None], self.colours[at][:, 1, :, None]
            T[at] = C_s * np.exp(-a * a - b * b)[:, None] + C_d * under.lights[k][:, 2]
        return T

    def channels(self) -> Channels:
        """Channels (texel,) of the material's maps."""
        return named(("theta", "phi", "dt", "dp"), self.shapes, self.colours)


def four_steps(samples: Samples, polar_tolerance: float, azimuth_tolerance: float) -> TakedaFit:
    """Fit Eq. 3 to samples by the four steps of the paper.

    Step 1 is read as Eq. 3 needs it: the half vector of the brightest light is the normal. Taken word for
    word (the light itself is n) the lobe would land at twice its angle.

    Parameters
    ----------
    polar_tolerance, azimuth_tolerance : float
        Largest differences, in radians, of equal θ_i and of equal φ_i: half a step of a grid.
    """
    found = TakedaFit(np.empty((len(samples), 4)), np.empty((len(samples), 2, 3)))
    for k, at in samples.under.cells():
        part = _four_steps(samples.T[at], samples.under.lights[k], polar_tolerance, azimuth_tolerance)
        found.shapes[at], found.colours[at] = part.shapes, part.colours
    return found


def _four_steps(T: NDArray[np.float32], lights: Array, polar_tolerance: float, azimuth_tolerance: float) -> TakedaFit:
    """The four steps under lights (light, 3)."""
    theta, phi = frames.angles(lights)
    cosine = np.cos(theta)
    luminance = T.mean(1, dtype=float)
    brightest = luminance.argmax(1)
    rows = np.arange(len(T))

    # 1. the brightest light gives n
    theta_n, phi_n = theta[brightest] / 2, phi[brightest]
    # 2. C_d where the azimuth is φ_n + π
    opposite = _near(phi, phi_n + np.pi, azimuth_tolerance) & (theta > 0)
    weight = opposite * cosine
    C_d = np.einsum("tcl,tl->tc", T, weight) / np.maximum((weight * cosine).sum(1), 1e-12)[:, None]
    C_d = np.maximum(C_d, 0)
    # 3. subtract it
    rest = luminance - C_d.mean(1)[:, None] * cosine
    # 4. C_s, dt and dp with n as the reference
    C_s = np.maximum(T[rows, :, brightest] - C_d * cosine[brightest][:, None], 0)
    ratio = rest / np.maximum(rest[rows, brightest], 1e-12)[:, None]
    usable = (ratio > FLOOR) & (ratio < 1)
    fall = -np.log(np.clip(ratio, 1e-12, 1))
    meridian = usable & _near(phi, phi_n, azimuth_tolerance)
    ring = usable & (np.abs(theta - theta[brightest][:, None]) <= polar_tolerance)
    dt = _width(theta / 2 - theta_n[:, None], fall, meridian, 0.01, 3.0, 0.05)
    dp = _width(frames.wrap(phi - phi_n[:, None]), fall, ring, 0.01, FLAT, FLAT)
    return TakedaFit(np.stack([theta_n, phi_n, dt, dp], 1), np.stack([C_s, C_d], 1))


def _near(phi: Array, centre: Array, tolerance: float) -> NDArray[np.bool_]:
    return np.asarray(np.abs(frames.wrap(phi - centre[:, None])) <= tolerance)


def _width(x: Array, fall: Array, used: NDArray[np.bool_], low: float, high: float, default: float) -> Array:
    """Least squares of fall = (x / width)² over the used samples of each texel; `default` without any."""
    square = np.where(used, x * x, 0)
    top, bottom = (square**2).sum(1), (square * fall).sum(1)
    width = np.sqrt(top / np.maximum(bottom, 1e-12))
    return np.where(bottom > 0, np.clip(width, low, high), default)
